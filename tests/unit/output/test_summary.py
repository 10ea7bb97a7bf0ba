import pytest

from heliograph.output import judge


@pytest.mark.parametrize(
    ("statuses", "status", "word"),
    [
        ({"first": 1, "tracked": 99}, "ok", None),
        ({"tracked": 95, "degenerate": 5}, "ok", None),
        ({"tracked": 80, "degenerate": 20}, "degraded", "unobservable in 20%"),
        ({"tracked": 80, "empty": 20}, "degraded", "20%"),
        ({"tracked": 85, "lost": 15}, "lost", "15%"),
        ({"tracked": 40, "predicted": 60}, "lost", "60%"),
        ({"tracked": 91, "degenerate": 9}, "ok", None),
        ({"tracked": 90, "degenerate": 10}, "degraded", "unobservable in 10%"),
        ({"tracked": 89, "degenerate": 11}, "degraded", "unobservable in 11%"),
        ({"tracked": 91, "empty": 9}, "ok", None),
        ({"tracked": 90, "empty": 4, "predicted": 6}, "degraded", "10%"),
        ({"tracked": 89, "predicted": 11}, "degraded", "11%"),
        ({"tracked": 91, "lost": 9}, "ok", None),
        ({"tracked": 90, "lost": 10}, "lost", "10%"),
        ({"tracked": 51, "empty": 49}, "degraded", "49%"),
        ({"tracked": 50, "empty": 50}, "lost", "50%"),
    ],
)
def test_judge_calls_a_run_by_the_share_of_bad_scans(statuses, status, word):
    verdict, reasons = judge(statuses, sensors=("lidar", "imu"))
    assert verdict == status
    assert (not reasons) if word is None else word in reasons[0]


def test_judge_calls_dead_reckoning_degraded():
    verdict, reasons = judge({"predicted": 50}, sensors=("imu",))
    assert verdict == "degraded" and "dead reckoning" in reasons[0]


def test_judge_interruption_is_a_reason_but_no_verdict():
    assert judge({"tracked": 9}, sensors=("lidar",), interrupted=True)[0] == "ok"


def test_judge_counts_the_scans_whose_match_the_imu_contradicts():
    assert judge({"tracked": 100}, sensors=("lidar", "imu"), against_imu=9)[0] == "ok"
    verdict, reasons = judge({"tracked": 100}, sensors=("lidar", "imu"), against_imu=10)
    assert verdict == "degraded" and "contradicts the match of 10%" in reasons[0]


def test_judge_counts_the_sweeps_that_outrun_a_model_without_an_imu():
    assert judge({"tracked": 100}, sensors=("lidar",), unsteady=9)[0] == "ok"
    verdict, reasons = judge({"tracked": 100}, sensors=("lidar",), unsteady=10)
    assert verdict == "degraded" and "changed within 10% of the sweeps" in reasons[0]


def test_judge_calls_a_run_degraded_that_something_else_speaks_against():
    verdict, reasons = judge({"tracked": 100}, sensors=("lidar",), doubts=("the clouds contradict the poses",))
    assert (verdict, reasons) == ("degraded", ("the clouds contradict the poses",))


def test_judge_calls_a_run_degraded_whose_imu_did_not_cover_the_scans():
    assert judge({"tracked": 100}, sensors=("lidar", "imu"), held=19)[0] == "ok"
    verdict, reasons = judge({"tracked": 100}, sensors=("lidar", "imu"), held=20)
    assert verdict == "degraded"
    assert "20%" in reasons[0]
