"""depthcli: batch stereo matching, depth refinement, fusion, confidence and their evaluation."""

__version__ = "0.1.0"
