"""Programs that complete depth maps, as pipelines of ``transparent``."""
