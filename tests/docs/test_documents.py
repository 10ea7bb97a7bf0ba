"""What the documents say holds: code blocks run, links lead somewhere, commands, settings and columns exist."""

import csv
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from heliograph.cli.main import app
from heliograph.config import RunConfig
from heliograph.config_toml import keys

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("benchmarks/*.md")])
NAMES = [str(document.relative_to(ROOT)) for document in DOCUMENTS]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def _blocks(name, language):
    return [body for kind, body in BLOCK.findall((ROOT / name).read_text()) if kind == language]


@pytest.fixture(scope="module")
def short_run(short_recording, tmp_path_factory):
    out = tmp_path_factory.mktemp("docs_run") / "run"
    done = CliRunner().invoke(app, ["run", str(short_recording), "-o", str(out), "--quiet"])
    assert done.exit_code == 0, done.output
    return out


@pytest.mark.parametrize("name", [name for name in NAMES if _blocks(name, "python")])
def test_documents_code_blocks_run_in_order(name, short_recording, short_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    space = {"path": short_recording, "run": short_run, "folder": tmp_path, "__name__": "document"}
    for number, block in enumerate(_blocks(name, "python"), start=1):
        exec(compile(block, f"{name}, block {number}", "exec"), space)


@pytest.mark.parametrize("name", NAMES)
def test_documents_links_lead_to_files(name):
    text = BLOCK.sub("", (ROOT / name).read_text())
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if "://" not in target:
            assert ((ROOT / name).parent / target).exists(), target


@pytest.mark.parametrize("name", [name for name in NAMES if _blocks(name, "sh")])
def test_documents_commands_have_the_options_shown(name):
    for line in "\n".join(_blocks(name, "sh")).splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] != ["heliograph"]:
            continue
        shown = CliRunner().invoke(app, [words[1], "--help-all"], env={"COLUMNS": "200"})
        assert shown.exit_code == 0, line
        for option in (word.split("=")[0] for word in words[2:] if word.startswith("-")):
            assert re.search(rf"(?<![\w-]){option}(?![\w-])", shown.output), f"{line}: no {option}"


@pytest.mark.parametrize("name", NAMES)
def test_documents_settings_exist(name):
    known = set(keys(RunConfig))
    sections = "|".join({key.split(".")[0] for key in known if "." in key})
    files = "ply|pcd|laz|png|pgw|py|csv|g2o|npz"
    for key in re.findall(rf"(?:`|--set )((?:{sections})\.(?!{files})[a-z_.]*[a-z_])", (ROOT / name).read_text()):
        assert key in known, key


def test_documents_name_every_column_of_the_scan_table(short_run):
    text = (ROOT / "docs" / "outputs.md").read_text()
    with (short_run / "scans.csv").open() as file:
        columns = next(csv.reader(file))
    for column in columns:
        stem = column.rpartition("_")[0]
        group = "ms" if column.startswith("ms_") else stem
        assert any(f"`{word}" in text for word in (f"{column}`", f"{group}_*`", f"{group}_{{")), column


def test_documents_name_every_file_of_a_run(short_run):
    text = (ROOT / "docs" / "outputs.md").read_text()
    for file in short_run.iterdir():
        assert f"`{file.name}`" in text, file.name


def test_documents_explain_every_warning():
    text = (ROOT / "docs" / "howto" / "bad_data.md").read_text()
    for file in (ROOT / "src").rglob("*.py"):
        for code in re.findall(r'code="([a-z-]+)"', file.read_text()):
            assert f"`{code}`" in text, f"{code} of {file.name}"


def test_reports_explain_warnings_as_the_document_does():
    table = [line for line in (ROOT / "docs/howto/bad_data.md").read_text().splitlines() if line.startswith("| `")]
    packaged = ROOT / "src" / "heliograph" / "report" / "warnings.md"
    assert packaged.read_text().splitlines() == table, "copy the table's rows into the package"


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 180
