"""Programs that match pairs, as pipelines of ``stereo``."""
