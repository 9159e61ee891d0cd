"""Cameras from photos of a board of known size: corners in images, lenses, and the places of two cameras."""
