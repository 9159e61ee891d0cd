"""Scenes with exact truth.

``stereo_scenes`` furnishes rooms (``room``), which ``rendering`` photographs, painted with ``textures``;
``kinect_scenes``, ``depth_sensor`` and ``transparent_scenes`` compute what sensors measure of a scene;
``deformed_volumes`` registers volumes badly. None of them knows a file: ``samples`` writes them in our own layouts.
"""
