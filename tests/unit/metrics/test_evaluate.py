import json

import numpy as np
import pytest

from heliograph.data import Trajectory
from heliograph.errors import ConfigError
from heliograph.lie import se3
from heliograph.metrics import evaluate


def path(n: int = 400) -> Trajectory:
    t = np.arange(n) * 0.1
    xi = np.stack([0 * t, 0.1 * np.sin(t), 0.2 * t, 10 * np.sin(0.2 * t), 8 * np.cos(0.3 * t), np.sin(0.5 * t)], axis=1)
    return Trajectory(stamps_ns=np.arange(n) * 100_000_000, T_frame_body=se3.exp(xi))


def test_evaluate_of_itself_is_zero():
    result = evaluate(path(), path())
    assert result.absolute.rmse < 1e-9
    assert result.relative.rotation_rmse_deg < 1e-6
    assert result.poses_compared == 400
    assert result.duration == pytest.approx(39.9)


def test_evaluate_auto_offset_is_applied():
    late = Trajectory(stamps_ns=path().stamps_ns + 20_000_000, T_frame_body=path().T_frame_body)
    result = evaluate(late, path(), time_offset="auto")
    assert result.time_offset == pytest.approx(-0.02, abs=2e-5)
    assert result.absolute.rmse < evaluate(late, path()).absolute.rmse / 50


def test_evaluate_as_dict_is_json_without_nan():
    text = json.dumps(evaluate(path(20), path(20), delta=1e6).as_dict(), allow_nan=False)
    out = json.loads(text)
    assert out["relative"]["n"] == 0
    assert out["relative"]["translation_rmse"] is None
    assert np.shape(out["absolute"]["T_reference_estimate"]) == (4, 4)
    assert "errors" not in out["absolute"]


def test_evaluate_refuses_an_unknown_offset_word():
    with pytest.raises(ConfigError, match="auto"):
        evaluate(path(), path(), time_offset="best")


def test_evaluate_tells_path_and_gap_of_what_is_compared():
    whole = path()
    half = Trajectory(stamps_ns=whole.stamps_ns[100:200], T_frame_body=whole.T_frame_body[100:200])
    result, p = evaluate(half, whole), half.T_frame_body[:, :3, 3]
    assert result.path_length == pytest.approx(np.linalg.norm(np.diff(p, axis=0), axis=1).sum())
    assert result.start_end_gap_reference == pytest.approx(np.linalg.norm(p[-1] - p[0]))
    assert evaluate(whole, half).start_end_gap == pytest.approx(result.start_end_gap_reference)
