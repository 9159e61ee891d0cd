"""Files: images, disparity maps, folders of scenes. The only package below the commands that opens paths."""
