"""What mkdocs does beyond its plugins.

Pages that are in no navigation go to its end, public names to the end of the API; the
notebooks are run and become pages; formulas become MathML, which browsers draw themselves.
"""

import html
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import latex2mathml.converter
import nbclient
import nbformat
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

import plantsim


def on_config(config: Any) -> Any:
    """Append the pages of docs/ that mkdocs.yml does not name."""
    named = set(_files(config["nav"]))
    here = Path(config["docs_dir"])
    rest = sorted(p.name for p in here.glob("*.md") if p.name not in named)
    config["nav"] += [{_title(here / name): name} for name in rest]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add a page for each notebook, as it comes out when it is run now."""
    for path in sorted(Path(config["docs_dir"], "notebooks").glob("*.ipynb")):
        page = f"notebooks/{path.stem}.md"
        files.append(File.generated(config, page, content=_run(path)))
    return files


def _run(path: Path) -> str:
    """Return a notebook as Markdown, run from first cell to last."""
    book = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        try:
            nbclient.NotebookClient(
                book, timeout=600, resources=where, extra_arguments=["--log-level=40"]
            ).execute()
        except nbclient.exceptions.CellExecutionError as why:
            raise PluginError(f"{path.name}: {why}") from why
    parts = []
    for cell in book.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        elif cell.cell_type == "code":
            parts.append(f"```{{.python .noexec}}\n{cell.source}\n```")
            told = [out for out in cell.outputs if out.get("name") != "stderr"]
            parts += [_output(out) for out in told]
    note = f"*Run when this site was built. [The notebook]({path.name}).*"
    title, _, rest = "\n\n".join(parts).partition("\n")
    return f"{title}\n\n{note}\n{rest}\n"


def _output(out: Any) -> str:
    """Return an output of a cell as HTML, on one line, where Markdown lets it alone."""
    if out.output_type == "stream":
        return f'<pre class="output">{html.escape(out.text.rstrip())}</pre>'
    data = out.get("data", {})
    if "text/html" in data:
        return f'<div class="output">{" ".join(data["text/html"].split())}</div>'
    if "image/png" in data:
        code = data["image/png"].strip()
        return f'<div class="output"><img src="data:image/png;base64,{code}"></div>'
    return f'<pre class="output">{html.escape(data.get("text/plain", ""))}</pre>'


def on_page_content(html: str, **_: Any) -> str:
    """Turn the formulas that arithmatex marked into MathML."""
    return re.sub(
        r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>',
        _formula,
        html,
        flags=re.S,
    )


def _formula(found: re.Match[str]) -> str:
    block = found[1] == "div"
    tex = html.unescape(found[2]).strip()
    maths = latex2mathml.converter.convert(tex, display="block" if block else "inline")
    return f'<div class="formula">{maths}</div>' if block else maths


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead links to notebooks to their pages; append to the API what is not on it yet."""
    if page.file.src_uri == "notebooks.md":
        return markdown.replace(".ipynb)", ".md)")
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
