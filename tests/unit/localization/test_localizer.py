"""Who wakes up in a mapped place is found; where places look alike, or there is no map, nobody claims to know."""

from dataclasses import replace

import numpy as np
import pytest
from kidnapped import bare_map, off, saved_map, twin_map, walk, woken

from heliograph.config import LocalizationConfig
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.localization import Localizer, MapPlace, decide, map_of_keyframes, map_of_points
from heliograph.localization.standing_places import standing_places

FIRST = 42


def told(localizer, results):
    return [localizer.add(result) for result in results]


def test_walk_is_long_enough_for_a_second_lap():
    assert len(walk().keyframes) >= FIRST + 19


@pytest.mark.parametrize("make", [saved_map, pytest.param(bare_map, marks=pytest.mark.slow)])
def test_localizer_finds_who_wakes_up_and_follows(make):
    results, T_true = woken(FIRST, 8)
    found = told(Localizer(make()), results)
    states = [one.state for one in found]
    assert states[:2] == ["not localised"] * 2 and states[2:] == ["localised"] * 6
    assert max(off(one.T_map_imu, T) for one, T in zip(found[2:], T_true[2:], strict=True)) < 0.05
    assert all(one.T_map_imu is None and one.covariance is None for one in found[:2])


def test_localizer_has_sigmas_that_cover_its_error_and_the_maps():
    clouds, T = [k.points_imu for k in walk().keyframes[:40]], walk().T_true[:40]
    vague = map_of_keyframes(clouds, T, lambda _: np.diag([1e-6] * 3 + [0.2**2] * 3))
    results, _ = woken(FIRST, 5)
    sure, unsure = (told(Localizer(m), results)[-1] for m in (saved_map(), vague))
    assert unsure.T_map_imu is not None
    assert np.all(unsure.sigma[3:] > 0.19) and np.all(sure.sigma[3:] < 0.05)


def test_localizer_calls_twins_ambiguous_and_never_locks():
    results, _ = woken(FIRST, 5)
    found = told(Localizer(twin_map()), results)
    assert {one.state for one in found} == {"ambiguous"}
    assert found[-1].places == 2


def test_localizer_in_a_map_of_another_place_knows_nothing():
    rng = np.random.default_rng(4)
    clouds = [np.ascontiguousarray(rng.normal(size=(3000, 3)) * [8.0, 8.0, 2.0], dtype=np.float32) for _ in range(3)]
    results, _ = woken(FIRST, 3, clouds=clouds)
    localizer = Localizer(saved_map())
    assert {one.state for one in told(localizer, results)} == {"not localised"}
    assert len(localizer.queries) == 3


def test_localizer_starts_where_the_user_says_at_the_first_scan():
    results, T_true = woken(FIRST, 2)
    near = T_true[0] @ se3.exp([0.0, 0.0, 0.1, 0.4, -0.3, 0.0])
    found = told(Localizer(twin_map(), start=near), results)
    assert found[0].state == "localised" and off(found[0].T_map_imu, T_true[0]) < 0.05


def test_localizer_refutes_a_wrong_start_and_searches():
    results, T_true = woken(FIRST, 5)
    wrong = T_true[0].copy()
    wrong[:2, 3] += 7.0
    localizer = Localizer(saved_map(), start=wrong)
    found = told(localizer, results)
    assert found[0].state == "not localised"
    assert any(event.code == "start-pose" for event in localizer.events)
    assert found[-1].state == "localised" and off(found[-1].T_map_imu, T_true[-1]) < 0.05


def test_localizer_notices_that_it_was_carried_off_and_locks_again():
    before, _ = woken(FIRST, 5)
    after, T_true = woken(FIRST + 7, 12)
    T = before[-1].T_odom_imu @ se3.inverse(after[0].T_odom_imu)  # odometry did not notice anything
    late = before[-1].end_ns - after[0].end_ns + round(1e9)
    moved = [
        replace(
            r, T_odom_imu=T @ r.T_odom_imu, T_odom_imu_header=T @ r.T_odom_imu,
            end_ns=r.end_ns + late, stamp_ns=r.stamp_ns + late, header_stamp_ns=r.header_stamp_ns + late,
        )
        for r in after
    ]  # fmt: skip
    localizer = Localizer(saved_map())
    assert told(localizer, before)[-1].state == "localised"
    found = told(localizer, moved)
    assert any(event.code == "localisation-lost" for event in localizer.events)
    assert found[-1].state == "localised" and off(found[-1].T_map_imu, T_true[-1]) < 0.05


def place(explained=0.6, confirmed=0.8, seen_through=0.0, held=True):
    return MapPlace(
        T_map_level=np.eye(4), covariance=np.eye(6), explained=explained, confirmed=confirmed,
        seen_through=seen_through, held=held,
    )  # fmt: skip


def test_decide_keeps_the_best_and_what_fits_nearly_as_well():
    config = LocalizationConfig()
    best, rival, other = place(0.7), place(0.95 * 0.7), place(0.5 * 0.7)
    assert decide([best, rival, other], config) == (best, rival)
    assert decide([place(0.1)], config) == ()
    assert decide([place(seen_through=0.3)], config) == ()
    assert decide([place(confirmed=0.1)], config) == ()


def test_decide_takes_no_place_for_sure_beside_one_that_explains_nearly_as_well_and_misses_a_bar():
    config = LocalizationConfig()
    best, near_miss = place(0.35), place(0.34, confirmed=0.4)
    assert decide([best, near_miss], config) == (best, near_miss)
    above = place(0.6, confirmed=0.4)
    assert decide([above, best], config) == (above, best)


def test_place_that_explains_little_stands_only_where_little_speaks_against_it():
    """Shelves of a warehouse in the map of a street: explained 0.32, confirmed 0.5, seen through 0.06."""
    config = LocalizationConfig()
    assert not place(0.318, confirmed=0.502, seen_through=0.059).stands(config)
    assert place(0.318, confirmed=0.502, seen_through=0.01).stands(config)
    assert place(0.6, confirmed=0.502, seen_through=0.059).stands(config)


def test_standing_places_are_above_each_floor_and_no_shelf():
    x, y = (g.ravel() for g in np.meshgrid(np.arange(0.0, 12.0, 0.2), np.arange(0.0, 12.0, 0.2)))
    storeys = [np.column_stack([x, y, np.full(len(x), z)]) for z in (0.0, 3.0)]
    shelf = storeys[0][(x < 1.0) & (y < 1.0)] + [0.5, 0.5, 1.2]
    found = standing_places(np.concatenate([*storeys, shelf]).astype(np.float32), 4.0)
    assert sorted(set(np.round(found[:, 2], 1))) == [1.3, 4.3]  # the upper one under the sky


@pytest.mark.parametrize(
    ("factor", "count", "away", "words"),
    [
        (1e6, 5000, 0.0, "millimetres"),
        (1e-3, 5000, 0.0, "kilometres"),
        (1.0, 100, 0.0, "too few"),
        (1.0, 5000, 5e6, "from its origin"),
    ],
)
def test_map_of_points_that_is_no_map_here_is_told_in_one_line(factor, count, away, words):
    points = np.random.default_rng(0).uniform(size=(count, 3)) * [40.0, 30.0, 5.0] * factor + away
    with pytest.raises(DataError, match=words):
        map_of_points(points)
