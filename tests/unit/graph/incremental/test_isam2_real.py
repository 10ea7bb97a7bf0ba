"""Published pose graphs replayed: near the batch optimum all along the way."""

import numpy as np
import pytest

from heliograph.graph import ISAM2, Marginals, read_pose_graph, solve
from heliograph.graph.model.families import family_of
from reference.replay import Replay

pytestmark = pytest.mark.real

SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "name", ["intel", *(pytest.param(name, marks=SLOW) for name in ("M3500", "kitti_00", "sphere2500"))]
)
def test_every_fiftieth_step_is_near_the_batch_solution(name, shared_data):
    path = shared_data / "posegraphs" / f"{name}.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    replay, smoother = Replay(read_pose_graph(path)), ISAM2()
    worst_chi2, worst_pose = 0.0, 0.0
    for k in range(len(replay.ids)):
        replay.step(smoother, k)
        if k % 50 != 49:
            continue
        graph, estimate = replay.whole(k + 1), smoother.estimate()
        batch = solve(graph, estimate, "gn", initial="given")
        # Where the chain has hardly a loop the optimum is nearly zero, and one per cent of it is nothing.
        worst_chi2 = max(worst_chi2, (batch.initial_chi2 - batch.chi2) / max(batch.chi2, 1e-3 * (k + 1)))
        free = estimate.keys()[estimate.keys() != replay.ids[0]]
        a, b = estimate.at(free), batch.values.at(free)
        family = family_of(a)
        d = family.local(b.matrix, a.matrix)
        sigma = np.sqrt(np.diagonal(Marginals(graph, batch.values).covariance(free), axis1=1, axis2=2))
        worst_pose = max(worst_pose, float((np.abs(d) / sigma).max()))
    assert worst_chi2 < 0.01
    assert worst_pose < 3.0
