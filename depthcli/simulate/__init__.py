"""Generated scenes with exact ground truth.

``stereo_scenes`` makes rooms (``room``) with ``textures``, and ``rendering`` renders them. ``kinect_scenes``,
``depth_sensor`` and ``transparent_scenes`` simulate sensors. ``deformed_volumes`` makes incorrect registrations. Only
``samples`` writes files, in our own layouts.
"""
