"""Pages that are in no navigation go to its end, public names to the end of the API."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import plantsim


def on_config(config: Any) -> Any:
    """Append the pages of docs/ that mkdocs.yml does not name."""
    named = set(_files(config["nav"]))
    here = Path(config["docs_dir"])
    rest = sorted(p.name for p in here.glob("*.md") if p.name not in named)
    config["nav"] += [{_title(here / name): name} for name in rest]
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Append to the API page what is public and not on it yet."""
    if page.file.src_uri != "api.md":
        return markdown
    shown = set(_shown(markdown))
    rest = [
        f"::: {module}.{name}"
        for name, module in sorted(plantsim._MODULE.items())
        if not {module, f"{module}.{name}"} & shown
    ]
    return markdown + ("\n\n## More\n\n" + "\n".join(rest) if rest else "")


def _shown(markdown: str) -> Iterator[str]:
    """Yield the names that a page shows: objects, whole modules, members of others."""
    for name, members in re.findall(
        r"^::: (\S+)(?:\n.*members: \[(.*)\])?", markdown, re.M
    ):
        whole = [name] if name.split(".")[-1][0].isupper() or not members else []
        yield from whole or [f"{name}.{m.strip()}" for m in members.split(",")]


def _files(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    values = nav if isinstance(nav, list) else list(nav.values())
    return [name for value in values for name in _files(value)]


def _title(page: Path) -> str:
    first = page.read_text(encoding="utf-8").splitlines()[0]
    return first.lstrip("# ").strip() or page.stem
