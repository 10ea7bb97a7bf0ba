"""What users do wrong and what recordings suffer from: one line and exit code 2, or a warning and a result."""

import json
import shutil

import doctor
import pytest

from heliograph.cli.main import main
from heliograph.sim import find_scenario
from heliograph.sim.write import write_recording

SECONDS = 7.0


def scenario(**changes):
    """A room in 16 beams: rest, then a few metres of walking."""
    return find_scenario("room").thinned(beams=16, columns=256, duration=SECONDS).varied(walk={"rest": 2.0}, **changes)


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("sabotage") / "room", scenario(), seed=1).folder


@pytest.fixture
def heliograph(tmp_path, monkeypatch, capsys):
    """Run the command in an empty folder; return code, standard output and the lines of standard error."""
    monkeypatch.setattr("heliograph.report.write_report", lambda _: [])  # a second a run, and not the subject
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, [line for line in err.splitlines() if line]

    return call


def assert_one_line(result, *words):
    code, _, lines = result
    assert code == 2
    assert len(lines) == 1 and lines[0].startswith("error: "), lines
    for word in words:
        assert word in lines[0]


# ------------------------------------------------------------------------------------------ errors: one line, exit 2


def test_missing_file_is_one_line(heliograph):
    assert_one_line(heliograph("run", "nowhere.mcap"), "nowhere.mcap")


def test_not_a_recording_is_one_line(heliograph, tmp_path):
    (tmp_path / "notes.bag").write_text("these are not the messages you are looking for\n" * 50)
    assert_one_line(heliograph("run", "notes.bag"), "notes.bag")
    (tmp_path / "notes.mcap").write_bytes(bytes(range(256)) * 20)
    assert_one_line(heliograph("info", "notes.mcap"), "notes.mcap")


def test_empty_folder_is_one_line(heliograph, tmp_path):
    (tmp_path / "empty").mkdir()
    assert_one_line(heliograph("run", "empty"), "empty")


def test_no_lidar_topic_is_one_line(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "blind", doctor.without(doctor.POINTS))
    assert_one_line(heliograph("run", "blind", "--sensors", "lidar,imu"), "LiDAR")


def test_wrong_topic_lists_the_valid_ones(heliograph, recording):
    assert_one_line(heliograph("run", recording, "--lidar-topic", "/point"), "/point", "/points")
    assert_one_line(heliograph("run", recording, "--imu-topic", "/imu"), "/imu/data")


def test_unknown_config_key_is_one_line_with_a_suggestion(heliograph, recording, tmp_path):
    (tmp_path / "mine.toml").write_text("[output]\nmap_voxle = 0.2\n")
    assert_one_line(heliograph("run", recording, "--config", "mine.toml"), "mine.toml", "map_voxel")
    assert_one_line(heliograph("run", recording, "--set", "output.map_voxle=0.2"), "map_voxel")
    assert_one_line(heliograph("run", recording, "--set", "output.map_voxel=wide"), "map_voxel")


def test_unwritable_output_is_one_line(heliograph, recording, tmp_path):
    (tmp_path / "file").write_text("")
    assert_one_line(heliograph("run", recording, "-o", "file"), "file", "-o")
    assert_one_line(heliograph("run", recording, "-o", "/proc/heliograph"), "/proc/heliograph")


def test_existing_output_is_kept_without_overwrite(heliograph, recording, tmp_path):
    assert heliograph("run", recording, "-o", "out", "--duration", 3, "-q")[0] == 0
    before = (tmp_path / "out" / "run.json").read_bytes()
    assert_one_line(heliograph("run", recording, "-o", "out"), "--overwrite")
    assert (tmp_path / "out" / "run.json").read_bytes() == before
    assert heliograph("run", recording, "-o", "out", "--overwrite", "--duration", 3, "-q")[0] == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("run",),
        ("run", "x", "--threads", "many"),
        ("run", "x", "--odometry", "magic"),
        ("run", "x", "--sensors", "sonar"),
        ("run", "x", "--sensor", "lidar"),
        ("simulate", "moon"),
        ("simulate", "room", "--layout", "abacus"),
        ("evaluate", "a.tum", "b.tum"),
        ("fly",),
        ("run", "x", "--extrinsic", "nowhere.toml"),
        ("run", "x", "--config", "nowhere.toml"),
    ],
)
def test_usage_errors_are_one_line(heliograph, arguments):
    assert_one_line(heliograph(*arguments))


def test_errors_leave_no_folder_behind(heliograph, recording, tmp_path):
    heliograph("run", "nowhere.mcap")
    heliograph("run", recording, "--lidar-topic", "/nothing")
    heliograph("run", recording, "--frame", "nose")
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------------------- damage: a warning and a result


def run_doctored(heliograph, folder, *options):
    """Run a recording and return its account; it must end well, with a trajectory."""
    code, out, lines = heliograph("run", folder, "-o", "out", "--json", "--quiet", *options)
    assert code == 0, lines
    facts = json.loads(out)
    assert facts["scans"] > 20
    return facts


def codes(facts):
    return {event["code"] for event in facts["warnings"] if event["severity"] != "info"}


def error_in(heliograph, recording, limit):
    """Evaluate ``out`` against the truth of the recording it was made from."""
    code, out, lines = heliograph("evaluate", "out", recording, "--delta", 1, "--json")
    assert code == 0, lines
    rmse = json.loads(out)["absolute"]["rmse"]
    assert rmse < limit, rmse


def test_sound_recording_has_no_warnings(heliograph, recording):
    facts = run_doctored(heliograph, recording)
    assert facts["status"] == "ok" and codes(facts) == set()
    error_in(heliograph, recording, 0.03)


def test_truncated_bag_is_used_as_far_as_it_can_be_read(heliograph, recording, tmp_path):
    folder = tmp_path / "cut"
    folder.mkdir()
    data = (recording / "recording.mcap").read_bytes()
    (folder / "recording.mcap").write_bytes(data[: int(0.8 * len(data))])
    facts = run_doctored(heliograph, folder / "recording.mcap")
    assert codes(facts), "a truncated file must be told"


def test_two_lidar_topics_are_decided_or_told(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "two", doctor.twice(doctor.POINTS, "/points_rear"))
    facts = run_doctored(heliograph, "two")
    assert any("/points_rear" in event["message"] for event in facts["warnings"])
    shutil.rmtree(tmp_path / "out")
    assert run_doctored(heliograph, "two", "--lidar-topic", "/points_rear")["status"] == "ok"


def test_two_imu_topics_are_decided_or_told(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "two", doctor.twice(doctor.IMU, "/camera/imu"))
    facts = run_doctored(heliograph, "two")
    assert any("/camera/imu" in event["message"] for event in facts["warnings"])


def test_no_imu_runs_on_the_lidar_and_says_so(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "noimu", doctor.without(doctor.IMU))
    facts = run_doctored(heliograph, "noimu")
    assert facts["sensors"] == ["lidar"] and codes(facts)


def test_no_tf_static_aligns_and_warns(heliograph, tmp_path):
    folder = write_recording(tmp_path / "notf", scenario(mount={"tf_static": False}), seed=1).folder
    facts = run_doctored(heliograph, folder)
    assert codes(facts)
    error_in(heliograph, folder, 0.15)


def test_imu_in_g_is_recognised(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "g", doctor.on_imu(doctor.imu_in_g))
    facts = run_doctored(heliograph, "g")
    assert any(item["value"].startswith("g") for item in facts["inferences"] if "accel" in item["name"])
    error_in(heliograph, recording, 0.03)


def test_nanoseconds_labelled_seconds_are_recognised(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "ns", doctor.on_points(doctor.times_labelled_seconds))
    facts = run_doctored(heliograph, "ns")
    assert any(item["value"] == "ns" for item in facts["inferences"] if "unit" in item["name"])
    error_in(heliograph, recording, 0.03)


def test_no_point_times_warns(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "untimed", doctor.on_points(doctor.times_dropped))
    assert codes(run_doctored(heliograph, "untimed"))
    error_in(heliograph, recording, 0.15)


def test_stamps_that_run_back_are_survived_and_counted(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "swapped", doctor.on_points(doctor.SwappedStamps()))
    assert codes(run_doctored(heliograph, "swapped"))
    error_in(heliograph, recording, 0.3)


def test_two_second_gap_is_survived_and_told(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "gap", doctor.Gap(3.0, 5.0))
    assert codes(run_doctored(heliograph, "gap"))


def test_nan_and_zero_points_do_no_harm(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "nan", doctor.on_points(doctor.nan_and_zero_points))
    run_doctored(heliograph, "nan")
    error_in(heliograph, recording, 0.03)


def test_a_fifth_of_empty_scans_is_survived_and_told(heliograph, recording, tmp_path):
    doctor.rewrite(recording, tmp_path / "empty", doctor.on_points(doctor.EveryFifthEmpty()))
    facts = run_doctored(heliograph, "empty")
    assert facts["status"] == "degraded" or codes(facts)
    error_in(heliograph, recording, 0.05)


def test_a_negated_accelerometer_is_mended_said_and_left_where_asked(heliograph, tmp_path):
    gait = {"frequency": 1.1, "bounce": 0.08, "lateral": 0.1, "roll_deg": 18.0, "pitch_deg": 14.0, "yaw_deg": 22.0}
    waved = scenario(gait=gait).thinned(columns=180, duration=10.0)
    sound = write_recording(tmp_path / "waved", waved, seed=2).folder
    doctor.rewrite(sound, tmp_path / "negated", doctor.on_imu(doctor.accel_negated))
    facts = run_doctored(heliograph, "negated")
    assert facts["status"] == "ok" and "repaired-accel-axes" in codes(facts)
    error_in(heliograph, sound, 0.03)
    shutil.rmtree(tmp_path / "out")
    assert run_doctored(heliograph, "negated", "--no-repair")["status"] != "ok"
