"""Doctests of docstrings as code on the API page, not as quotations."""

import re
from typing import Any

import griffe

# a line that starts with >>> and all up to the next empty line
DOCTEST = re.compile(r"^>>> .*?(?=\n[ ]*\n|\Z)", re.M | re.S)


class Fences(griffe.Extension):
    """Put fences round doctests."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Rewrite one docstring."""
        if obj.docstring:
            fenced = DOCTEST.sub(lambda m: f"```pycon\n{m[0]}\n```", obj.docstring.value)
            obj.docstring.value = fenced
