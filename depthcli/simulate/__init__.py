"""Scenes with exact truth.

``arrays/`` computes them and knows no files: ``stereo_scenes`` renders a ``room`` of ``surfaces`` painted with
``textures``; ``kinect_scenes`` (with ``boards``), ``transparent_scenes`` and ``infrared`` say what sensors measure
of a scene; ``deformed_volumes`` makes pairs of volumes. ``samples/`` writes them in our own layouts, one module per
kind of ``depthcli sample``.
"""
