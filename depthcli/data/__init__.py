"""Files: images, disparity maps, folders of scenes. The only package below jobs/ that opens paths."""
