"""run.json as a manifest: its schema, checksums that are right, codes that stay."""

import hashlib
import json
import re
from pathlib import Path

import pytest
from test_run_folder import make_folder, run_into

import heliograph.output
from heliograph.output.facts import RUN_SCHEMA
from heliograph.output.manifest import fingerprint, hashed_files, hashed_inputs
from heliograph.output.reasons import ACTIONS, Reason, next_action, reason_facts
from heliograph.output.summary import judge

SCHEMA = json.loads((Path(heliograph.output.__file__).parent / "run.schema.json").read_text())
KINDS = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}


def faults(value, schema, where="run.json"):
    """What JSON Schema says against a value, for the words that the schema uses."""
    kinds = [schema["type"]] if isinstance(schema.get("type"), str) else schema.get("type", [])
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    fits = {"integer": number and value == int(value) if number else False, "number": number}
    if kinds and not any(fits.get(kind, isinstance(value, KINDS.get(kind, ()))) for kind in kinds):
        return [f"{where} is no {kinds}: {value!r}"]
    found = []
    if ("const" in schema and value != schema["const"]) or ("enum" in schema and value not in schema["enum"]):
        found.append(f"{where} is {value!r}")
    if "pattern" in schema and not re.search(schema["pattern"], value):
        found.append(f"{where} is {value!r}, not {schema['pattern']}")
    if "minimum" in schema and value < schema["minimum"]:
        found.append(f"{where} is {value!r}")
    if isinstance(value, dict):
        found += [f"{where} has no {name}" for name in schema.get("required", ()) if name not in value]
        for name, part in schema.get("properties", {}).items():
            found += faults(value[name], part, f"{where}.{name}") if name in value else []
    if isinstance(value, list) and "items" in schema:
        found += [fault for k, item in enumerate(value) for fault in faults(item, schema["items"], f"{where}[{k}]")]
    return found


def test_manifest_of_a_run_follows_its_schema_and_its_checksums_are_right(tmp_path):
    run_into(make_folder(tmp_path / "out"))
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert facts["schema"] == RUN_SCHEMA == SCHEMA["title"]
    assert faults(facts, SCHEMA) == []
    assert {entry["name"] for entry in facts["outputs"]} == set(facts["files"]) - {"run.json"}
    for entry in facts["outputs"]:
        content = (tmp_path / "out" / entry["name"]).read_bytes()
        assert entry["bytes"] == len(content) and entry["sha256"] == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize(
    "change", [{"status": "fine"}, {"scans": -1}, {"verdict": {}}, {"outputs": [{"name": "a"}]}, {"files": "a"}]
)
def test_manifest_schema_sees_what_is_wrong(tmp_path, change):
    run_into(make_folder(tmp_path / "out"))
    assert faults(json.loads((tmp_path / "out" / "run.json").read_text()) | change, SCHEMA)


def test_manifest_every_reason_has_a_code_and_one_action():
    _, reasons = judge({"lost": 30, "predicted": 40, "tracked": 30}, sensors=("lidar",), held=40, interrupted=True)
    assert [fact["code"] for fact in reason_facts(reasons)] == ["lost", "lost", "imu-held", "interrupted"]
    assert [fact["code"] for fact in reason_facts(judge({"tracked": 5}, sensors=("imu",))[1])] == ["imu-alone"]
    assert [fact["code"] for fact in reason_facts(judge({"predicted": 2, "tracked": 8}, sensors=("lidar",))[1])] == [
        "unmatched"
    ]
    assert reason_facts(["of somebody else"]) == [
        {"code": "other", "text": "of somebody else", "action": ACTIONS["other"]}
    ]
    assert next_action("ok", (), "") == ACTIONS["ok"] and next_action("ok", (), "disk full") == ACTIONS["failure"]
    assert next_action("degraded", reasons[2:], "") == ACTIONS["imu-held"]
    assert json.loads(json.dumps(list(reasons))) == [str(reason) for reason in reasons]
    with pytest.raises(ValueError, match="no code of a reason"):
        Reason("elsewhere", "text")


def test_manifest_documents_name_every_code():
    text = (Path(__file__).parents[3] / "docs" / "outputs.md").read_text()
    for code in ACTIONS:
        assert f"| `{code}` |" in text, code


def test_manifest_hashes_whole_files_samples_large_ones_and_tells_folders_apart(tmp_path):
    bag = tmp_path / "bag"
    (bag / "sub").mkdir(parents=True)
    (bag / "a.db3").write_bytes(b"a" * 3_000_000)
    (bag / "sub" / "b.yaml").write_bytes(b"b")
    (bag / "out").mkdir()
    for name in ("run.json", "config.toml", "map.ply"):
        (bag / "out" / name).write_bytes(b"{}")
    full = hashed_inputs([bag])
    assert [entry["name"] for entry in full] == ["bag/a.db3", "bag/sub/b.yaml"], "a run inside is no part of it"
    assert full[0]["sha256"] == hashlib.sha256(b"a" * 3_000_000).hexdigest()
    assert "sha256" not in hashed_inputs([bag], "sampled")[0] and "sampled_sha256" in hashed_inputs([bag], "sampled")[0]
    assert hashed_inputs([bag], "none") == [{"name": e["name"], "bytes": e["bytes"]} for e in full]
    before = fingerprint([bag])
    content = bytearray(b"a" * 3_000_000)
    content[-5] = 0
    (bag / "a.db3").write_bytes(content)
    assert fingerprint([bag]) != before
    assert hashed_files([tmp_path / "absent"]) == []


def test_manifest_sums_very_many_files_up(tmp_path):
    for k in range(1200):
        (tmp_path / f"{k:05d}.pcd").write_bytes(b"%d" % k)
    [one] = hashed_inputs([tmp_path])
    assert one["name"] == "1200 files" and one["bytes"] == sum(len(b"%d" % k) for k in range(1200))
    (tmp_path / "00007.pcd").write_bytes(b"x")
    assert hashed_inputs([tmp_path])[0]["sha256"] != one["sha256"]
