"""The page of an evaluation: one HTML file to look at maps, errors and numbers, made from what a protocol declares."""
