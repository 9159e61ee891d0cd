"""A plug-in for depthcli: one module for each thing that it adds."""
