"""Parts of the segment-based pipeline: first estimate, planes, energy, what can be looked at."""
