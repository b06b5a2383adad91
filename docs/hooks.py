"""Pages that nobody put into the navigation yet go to its end, so that none is lost."""

from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """Append the pages of docs/ that mkdocs.yml does not name."""
    named = set(_files(config["nav"]))
    here = Path(config["docs_dir"])
    rest = sorted(p.name for p in here.glob("*.md") if p.name not in named)
    config["nav"] += [{_title(here / name): name} for name in rest]
    return config


def _files(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    values = nav if isinstance(nav, list) else list(nav.values())
    return [name for value in values for name in _files(value)]


def _title(page: Path) -> str:
    first = page.read_text(encoding="utf-8").splitlines()[0]
    return first.lstrip("# ").strip() or page.stem
