"""Measures of error, curves, tables and pictures. Algorithms on arrays; files are written by jobs/."""
