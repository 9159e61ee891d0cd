"""Fixtures of the plots: the scenes and runs that the page is tested with."""

from tests.report.conftest import made, runs, scenes

__all__ = ["made", "runs", "scenes"]
