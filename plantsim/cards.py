"""What a notebook shows of a value: its repr as a small card."""

import html
from typing import Any

_BOX = "border-left:4px solid #009e73;padding:0.3em 0.8em;font-family:sans-serif"
_CHIP = (
    "display:inline-block;border:1px solid #bbb;border-radius:0.7em;"
    "padding:0 0.6em;margin:0.15em 0.25em 0 0;font-size:0.85em"
)


def card(value: Any) -> str:
    """Return the repr "Name(this, that; and this)" of a value as HTML, a chip for each."""
    name, inside, parts = *_opened(repr(value)), []
    depth, start = 0, 0
    for i, letter in enumerate(inside):
        depth += (letter in "([") - (letter in ")]")
        if not depth and inside[i : i + 2] in (", ", "; "):
            parts.append(inside[start:i])
            start = i + 2
    parts.append(inside[start:])
    chips = "".join(f'<span style="{_CHIP}">{html.escape(p)}</span>' for p in parts if p)
    return f'<div style="{_BOX}"><b>{html.escape(name)}</b><br/>{chips}</div>'


def _opened(text: str) -> tuple[str, str]:
    name, bracket, rest = text.partition("(")
    return (name, rest.removesuffix(")")) if bracket else (name, "")
