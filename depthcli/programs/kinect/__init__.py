"""Programs that refine depth maps, as pipelines of ``refine-kinect``."""
