"""Kinect depth maps: gaps filled, depth edges moved to where the color edges are (thesis chapter 4)."""
