"""How results look: tables as text, Markdown, LaTeX and CSV, maps as pictures.

``table`` has the one ``Column`` and the one ``Table`` of the package; ``view`` the one ``View`` of a map, what its
colors mean, and its painter ``draw``; ``volumes`` paints the slices of two volumes with maps over them.
"""
