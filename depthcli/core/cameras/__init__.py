"""Cameras and what two of them measure together: ``camera`` (one camera), ``triangulation`` (disparity and depth),
``rig`` (two cameras at fixed places, and their rectification), ``kinect`` (a sensor's raw codes)."""
