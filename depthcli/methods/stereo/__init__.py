"""Stereo: a rectified image pair in, a disparity map out (thesis chapters 2 and 3)."""
