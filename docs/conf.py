"""Settings of Sphinx; ``scripts/docs`` builds the site."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

import depthcli

project = "depthcli"
copyright = "the depthcli authors"
release = version = depthcli.__version__
extensions = ["myst_parser", "sphinx_copybutton"]
exclude_patterns = ["files"]
nitpicky = True
html_theme = "furo"
html_title = f"depthcli {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
smartquotes = False  # "--input" stays as it is
pygments_style, pygments_dark_style = "tango", "monokai"
myst_enable_extensions = ["deflist", "dollarmath", "colon_fence"]
myst_heading_anchors = 6
suppress_warnings = ["config.cache"]
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True


def _equation(code: str, display: str) -> str:
    """A formula as MathML, which browsers show without a script; docutils turns TeX into it."""
    return str(tex2mathml(code, as_block=display == "block"))


def _inline(translator: Any, node: Any) -> None:
    translator.body.append(_equation(node.astext(), "inline"))
    raise nodes.SkipNode


def _block(translator: Any, node: Any) -> None:
    translator.body.append(f'<div class="math">{_equation(node.astext(), "block")}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Register the renderer of formulas."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))


html_math_renderer = "mathml"
