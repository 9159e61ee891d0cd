"""Comparison of runs with ground truth. Files are written by the commands.

``protocols`` score a map (``scores``: values, ``curves``: sparsification); ``results`` holds the scores of one map,
``comparison`` those of all runs, with means and ranks, and ``statistics`` the tests behind them. ``tables`` arranges
them, ``render`` writes any table as text, Markdown, LaTeX, CSV or HTML, ``plots`` draws. ``map_files`` says where the
maps of a run lie, ``presentation`` how a protocol's figures are shown, ``benchmarks`` what a submission holds.
"""
