"""Stage the pages of the documentation's site: every document where it lies in the repository, and the generated API.

    python docs/site/stage.py build/site/pages

Documents link to each other, to examples and to source files by relative paths, as they must to be read in a clone. The
stage keeps those paths: it holds the documents and each file that one of them links to. A link that leads nowhere is
an error.
"""

from __future__ import annotations

import ast
import re
import shutil
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
BLOCK = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


class _Tolerant(yaml.SafeLoader):
    """Reads over the tags that only MkDocs knows."""


_Tolerant.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: suffix)  # noqa: ARG005


def documents() -> list[Path]:
    """Return the documents of the site."""
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("benchmarks/*.md")]
    return sorted(path.relative_to(ROOT) for path in found)


def linked(document: Path) -> list[Path]:
    """Return the files that a document links to, from the root; raise where one is not there."""
    text, files = BLOCK.sub("", (ROOT / document).read_text(encoding="utf-8")), []
    for target in LINK.findall(text):
        if "://" not in target and not target.startswith("mailto:"):
            path = (ROOT / document).parent.joinpath(target).resolve()
            if not path.is_file():
                sys.exit(f"{document}: {target} is no file")
            files.append(path.relative_to(ROOT))
    return files


def public_modules() -> list[str]:
    """Return the packages of the library and their modules that are rooms of one file, where they have public names."""
    source, names = ROOT / "src" / "heliograph", []
    for path in sorted([*source.glob("*/__init__.py"), *source.glob("*.py")]):
        name = ".".join(path.relative_to(source.parent).with_suffix("").parts).removesuffix(".__init__")
        if path.parent == source and path.stem.startswith("_"):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(n, ast.Assign) and getattr(n.targets[0], "id", "") == "__all__" for n in tree.body):
            names.append(name)
    return names


def stage(pages: Path) -> None:
    """Copy documents and what they link to, write the API's pages and the navigation with folders written out."""
    shutil.rmtree(pages, ignore_errors=True)
    chosen = documents()
    for path in {*chosen, *(file for document in chosen for file in linked(document))}:
        (pages / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, pages / path)
    (pages / "api").mkdir()
    for name in public_modules():
        (pages / "api" / f"{name}.md").write_text(
            f"# {name}\n\n::: {name}\n    options: {{show_root_heading: false}}\n"
        )
    text = (ROOT / "docs" / "site" / "mkdocs.yml").read_text(encoding="utf-8")
    for folder in re.findall(r"[ :]([a-z/]+/)\n", text[text.index("\nnav:") :]):
        files = sorted(path.relative_to(pages).as_posix() for path in (pages / folder).glob("*.md"))
        text = text.replace(f" {folder}\n", f" [{', '.join(files)}]\n")
    settings = yaml.load(text, _Tolerant)
    named = set(re.findall(r"[\w./-]+\.md", str(settings["nav"])))
    if missing := {path.as_posix() for path in chosen} - named:
        sys.exit(f"not in the site's navigation: {', '.join(sorted(missing))}")
    (pages.parent / "mkdocs.yml").write_text(
        text.replace("../../build/site/", "").replace("../../src", str(ROOT / "src"))
    )


if __name__ == "__main__":
    stage(Path(sys.argv[1]).resolve())
