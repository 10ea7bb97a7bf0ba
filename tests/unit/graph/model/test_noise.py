"""Noise: S' S is the information in every form; what is no noise is refused with the factor's name."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import GraphError
from heliograph.graph import Constrained, Covariance, Diagonal, Information, Isotropic, SquareRoot
from heliograph.graph.model.noise import DIAGONAL, FULL, SCALAR


def full(whitening, rows):
    """Information matrices of a whitening, (K, rows, rows)."""
    s = whitening.sqrt_information
    if whitening.form == SCALAR or whitening.form == DIAGONAL:
        S = s[:, :, None] * np.eye(rows)
    else:
        S = s.reshape(-1, rows, rows)
        assert not np.tril(S, -1).any(), "a root is not upper triangular"
    return np.swapaxes(S, 1, 2) @ S


def random_spd(rng, count, rows):
    A = rng.normal(size=(count, rows, rows))
    return A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(rows)


@pytest.mark.parametrize("count", [None, 1, 4])
def test_every_form_gives_its_information(rng, count):
    batch = () if count is None else (count,)
    P = random_spd(rng, count or 1, 3).reshape(*batch, 3, 3)
    A = rng.normal(size=(*batch, 3, 3))
    sigma, sigmas = rng.uniform(0.1, 2.0, batch), rng.uniform(0.1, 2.0, (*batch, 3))
    eye = np.eye(3)
    for noise, information, form in (
        (Isotropic(sigma), eye / np.asarray(sigma)[..., None, None] ** 2, SCALAR),
        (Diagonal(sigmas), eye / sigmas[..., None] ** 2, DIAGONAL),
        (Covariance(P), np.linalg.inv(P), FULL),
        (Information(P), P, FULL),
        (SquareRoot(A), np.swapaxes(A, -1, -2) @ A, FULL),
    ):
        whitening = noise.whitening(3, count or 7)
        assert whitening.form == form == noise.form
        assert noise.shared == (count is None) == whitening.shared and not whitening.constrained
        np.testing.assert_allclose(full(whitening, 3), information.reshape(-1, 3, 3), rtol=1e-9, atol=1e-12)


def test_the_simplest_form_is_found():
    assert Information(4.0 * np.eye(3)).whitening(3, 5).sqrt_information.tolist() == [[2.0]]
    diagonal = Covariance(np.diag([1.0, 4.0])).whitening(2, 5)
    assert diagonal.form == DIAGONAL and diagonal.sqrt_information.tolist() == [[1.0, 0.5]]
    assert Information(np.diag([1.0, 0.0, 4.0])).whitening(3, 1).sqrt_information.tolist() == [[1.0, 0.0, 2.0]]
    equal = Diagonal(np.full((6, 2), 0.5)).whitening(2, 6)
    assert equal.shared and equal.form == SCALAR and equal.sqrt_information.tolist() == [[2.0]]


def test_a_constraint_is_flagged():
    whitening = Constrained().whitening(6, 3)
    assert whitening.constrained and whitening.shared and whitening.sqrt_information.tolist() == [[1.0]]


@given(st.integers(1, 6), st.integers(0, 6), st.integers(0, 2**32 - 1))
@settings(max_examples=80, deadline=None, derandomize=True)
def test_singular_information_keeps_its_null_space(rows, rank, seed):
    rng = np.random.default_rng(seed)
    # Radians beside metres: the scale of the rows differs by a million.
    A = rng.normal(size=(min(rank, rows), rows)) * 10.0 ** rng.uniform(-3, 3, rows)
    omega = A.T @ A
    found = full(Information(omega).whitening(rows, 1), rows)[0]
    scale = np.sqrt(np.maximum(np.diag(omega), 1e-30))
    np.testing.assert_allclose(found / np.outer(scale, scale), omega / np.outer(scale, scale), atol=1e-7)


def named(row):
    return f"factor {10 + row} (keys 3, {row})"


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (Isotropic(0.0), r"factor 10 \(keys 3, 0\): its standard deviation is 0; it must be positive"),
        (Isotropic([1.0, -2.0]), r"factor 11 .* -2"),
        (Isotropic(np.inf), r"factor 10 .*not finite"),
        (Isotropic(1e-200), r"standard deviation is 1e-200"),
        (Diagonal([[1.0, 1.0], [1.0, np.nan]]), r"factor 11 .*not finite"),
        (Diagonal([1.0, 0.0]), r"factor 10 .*standard deviation is 0"),
        (Diagonal([1.0, 1.0, 1.0]), r"2 rows, so Diagonal needs 2 numbers a factor, got shape \(3,\)"),
        (Information(np.eye(3)), r"needs 2 x 2 numbers"),
        (Information(np.diag([1.0, -6e6])), r"factor 10 .*positive semi-definite: smallest eigenvalue -6e\+06"),
        (Information([np.eye(2), [[1.0, 2.0], [2.0, 1.0]]]), r"factor 11 .*smallest eigenvalue -1"),
        (Information([[1.0, 0.5], [0.0, 1.0]]), r"not symmetric"),
        (Information([[0.0, 1.0], [1.0, 1.0]]), r"positive semi-definite"),
        (Covariance(np.diag([1.0, 0.0])), r"covariance matrix is not positive definite: smallest eigenvalue 0"),
        (Covariance([np.eye(2), [[1.0, 2.0], [2.0, 1.0]]]), r"factor 11 .*smallest eigenvalue -1"),
        (SquareRoot([[1.0, np.nan], [0.0, 1.0]]), r"not finite"),
        (Isotropic([1.0, 1.0, 1.0]), r"for 3 factors, but there are 2"),
    ],
)
def test_what_is_no_noise_is_refused_by_name(noise, message):
    with pytest.raises(GraphError, match=message):
        noise.whitening(2, 2, named)


@pytest.mark.parametrize("make", [lambda: Isotropic(np.ones((2, 2))), lambda: Diagonal(1.0), lambda: Covariance([1.0])])
def test_wrong_axes_are_refused(make):
    with pytest.raises(GraphError, match="axes"):
        make()


def test_printed_rounding_is_forgiven():
    """A singular matrix with six printed digits has a negative eigenvalue, and is still meant to be singular."""
    v = np.array([0.123457, 4.56789, 300.123])
    omega = np.array([[float(f"{x:.6g}") for x in row] for row in np.outer(v, v)])
    assert np.linalg.eigvalsh(omega)[0] < -1e-9
    np.testing.assert_allclose(full(Information(omega).whitening(3, 1), 3)[0], omega, rtol=3e-5)


def test_one_number_is_the_array_of_it():
    for sigma in (0.25, np.float64(0.25)):
        lone, array = Isotropic(sigma), Isotropic(np.array(0.25))
        assert repr(lone) == repr(array)
        assert lone.shared
        np.testing.assert_array_equal(lone.numbers, array.numbers)
        assert not lone.numbers.flags.writeable
        for rows in (1, 6):
            np.testing.assert_array_equal(lone.ready(rows).sqrt_information, array.ready(rows).sqrt_information)
    assert pickle.loads(pickle.dumps(Isotropic(0.25))).numbers == 0.25
    for bad in (0.0, -1.0, np.nan, np.inf):
        assert Isotropic(bad).ready(3) is None
        with pytest.raises(GraphError, match="noise"):
            Isotropic(bad).whitening(3, 1)
