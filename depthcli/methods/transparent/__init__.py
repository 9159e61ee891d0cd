"""Depth of transparent objects, which depth sensors see through or not at all (chapter 5)."""
