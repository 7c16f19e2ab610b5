"""Writes equations as MathML while the pages are built; browsers draw it without a script."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

#: What stands on a letter: hat, tilde, bar.
ACCENTS = ("ˆ", "~", "¯", "‾")


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer that ``html_math_renderer = "mathml"`` asks for."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def mathml(tex: str, display: bool = False) -> str:
    """LaTeX as a MathML element. Raises ValueError for what docutils would read wrongly."""
    if re.search(r"\\[td]?frac[^{]", tex):
        raise ValueError(f"write \\frac{{1}}{{2}} with braces: {tex}")
    text = tex2mathml(tex, as_block=display).replace("&ApplyFunction;", "&#8289;")
    ET.register_namespace("", "http://www.w3.org/1998/Math/MathML")
    root = ET.fromstring(text)
    for element in root.iter():
        _accent_apart(element)
    return ET.tostring(root, encoding="unicode")


def _accent_apart(element: Any) -> None:
    """docutils writes an index of an accented letter below it: make it an index again."""
    space = element.tag.rpartition("}")[0] + "}"
    if element.tag != f"{space}munderover" or element[2].text not in ACCENTS:
        return
    letter, index, accent = list(element)
    for child in (letter, index, accent):
        element.remove(child)
    over = ET.SubElement(element, f"{space}mover", accent="true")
    over.extend([letter, accent])
    element.append(index)
    element.tag = f"{space}msub"


def _inline(page: Any, node: nodes.math) -> None:
    page.body.append(mathml(node.astext()))
    raise nodes.SkipNode


def _display(page: Any, node: nodes.math_block) -> None:
    page.body.append(f'<div class="equation">{mathml(node.astext(), display=True)}</div>')
    raise nodes.SkipNode
