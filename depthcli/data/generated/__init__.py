"""Scenes with exact ground truth."""
