"""Output of results: tables as text, Markdown, LaTeX and CSV, maps as pictures.

``table`` has ``Column`` and ``Table``; ``view`` has the ``View`` of a map, the meaning of its colors, and ``draw``;
``volumes`` draws slices of two volumes with maps over them.
"""
