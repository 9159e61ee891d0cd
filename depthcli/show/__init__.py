"""How results look: tables as text, Markdown, LaTeX and CSV, maps as pictures.

``table`` has the one ``Column`` and the one ``Table`` of the package.
"""
