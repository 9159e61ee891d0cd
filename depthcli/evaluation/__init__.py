"""Measures of error, curves, tables and pictures. Files are written by the commands."""
