import struct
import zlib

import numpy as np
import pytest

from heliograph.report.colors import GROUND, HEIGHT
from heliograph.report.lettering import lettered, world_file
from heliograph.report.png import encode_png
from heliograph.report.raster import color_image, render, side_view, top_view
from heliograph.report.svg import round_length


def decode(png):
    """Read back what `encode_png` writes: 8-bit RGB, filter 2."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, body = 8, b""
    while at < len(png):
        (length,), kind = struct.unpack(">I", png[at : at + 4]), png[at + 4 : at + 8]
        chunk = png[at + 8 : at + 8 + length]
        (crc,) = struct.unpack(">I", png[at + 8 + length : at + 12 + length])
        assert crc == zlib.crc32(kind + chunk)
        if kind == b"IHDR":
            width, height = struct.unpack(">II", chunk[:8])
        body += chunk if kind == b"IDAT" else b""
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(body), dtype=np.uint8).reshape(height, width * 3 + 1)
    assert (rows[:, 0] == 2).all()
    return np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8).reshape(height, width, 3)


def test_png_reads_back_as_the_image(rng):
    image = rng.integers(0, 256, (13, 7, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decode(encode_png(image)), image)


def grid(size=20.0, step=0.1):
    x, y = np.meshgrid(np.arange(0, size, step), np.arange(0, size / 2, step))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.float32)


def test_render_shows_the_point_in_front(rng):
    floor = grid()
    lid = np.array([[10.0, 5.0, 3.0]], dtype=np.float32)
    points = np.concatenate([lid, floor])[rng.permutation(len(floor) + 1)]
    view = top_view(points, floor[:2].astype(float))
    raster = render(points, view)
    column, row = view.to_pixels(lid)[0].astype(int)
    assert points[raster.nearest[row, column], 2] == 3.0


def test_render_puts_points_where_to_pixels_says(rng):
    points = rng.uniform(0, 10, (200, 3)).astype(np.float32)
    view = top_view(points, points[:2].astype(float))
    raster = render(points, view, point_size=0.0)
    column, row = view.to_pixels(points).astype(int).T
    shown = raster.nearest[row, column]
    assert (shown >= 0).all()
    assert (points[shown, 2] >= points[:, 2] - 1e-3).all(), "nothing lower hides anything higher"


def test_render_closes_gaps_between_points_but_not_wide_ones():
    points = grid(step=0.1)
    hole = (np.abs(points[:, 0] - 10) < 2) & (np.abs(points[:, 1] - 5) < 2)
    view = top_view(points[~hole], points[:2].astype(float))
    seen = render(points[~hole], view).nearest >= 0
    inside = view.to_pixels(np.array([[3.0, 3.0, 0.0], [10.0, 5.0, 0.0]])).astype(int)
    column, row = inside[0]
    assert seen[row - 20 : row + 20, column - 20 : column + 20].all()
    assert not seen[inside[1][1], inside[1][0]]


def test_top_view_lays_the_longer_side_down():
    wide, tall = grid(), grid()[:, [1, 0, 2]].copy()
    assert top_view(wide, wide[:2].astype(float)).labels == ("x", "y")
    turned = top_view(tall, tall[:2].astype(float))
    assert turned.labels == ("−y", "x")
    assert np.linalg.det(turned.axes) == pytest.approx(1.0), "a turned picture must not be a mirrored one"


def test_pictures_have_up_at_the_top():
    points = np.concatenate([grid(), [[10.0, 9.0, 5.0]]]).astype(np.float32)
    top = top_view(points, points[:2].astype(float))
    side = side_view(points, points[-2:].astype(float), top)
    corners = np.array([[1.0, 1.0, 0.0], [19.0, 9.0, 5.0]])
    (left, bottom), (right, upper) = top.to_pixels(corners)
    assert left < right and upper < bottom
    (left, bottom), (right, upper) = side.to_pixels(corners)
    assert left < right and upper < bottom
    rows, columns = top.shape
    assert top.to_pixels(corners).min() >= 0 and (top.to_pixels(corners) < (columns, rows)).all()


def test_side_view_shares_the_horizontal_axis_and_the_scale():
    points = grid()
    top = top_view(points, points[:2].astype(float))
    side = side_view(points, points[:2].astype(float), top)
    assert side.pixel == top.pixel and abs(side.shape[1] - top.shape[1]) <= 1
    assert np.linalg.det(side.axes) == pytest.approx(1.0)
    np.testing.assert_allclose(side.to_pixels(points)[:, 0], top.to_pixels(points)[:, 0], atol=0.05)


def test_shading_darkens_what_lies_beside_something_higher():
    points = grid(step=0.05)
    points[points[:, 0] > 10, 2] = 2.0
    view = top_view(points, points[:2].astype(float))
    raster = render(points, view)
    at = view.to_pixels(np.array([[10.0, 5.0, 0.0], [5.0, 5.0, 0.0], [15.0, 5.0, 2.0]])).astype(int)
    edge, open_floor, roof = (raster.shade[row, column - 5 : column + 5].min() for column, row in at)
    assert edge < 0.7 * open_floor and roof == pytest.approx(1.0)


def test_color_image_spans_the_scale_and_leaves_the_ground():
    points = grid()
    values = points[:, 0].copy()
    view = top_view(points, points[:2].astype(float))
    raster = render(points, view)
    image = color_image(raster, values, HEIGHT, (0.0, 20.0))
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image[raster.nearest < 0], np.tile(GROUND, (int((raster.nearest < 0).sum()), 1)))
    column, row = view.to_pixels(np.array([[0.5, 5.0, 0.0], [19.5, 5.0, 0.0]])).astype(int).T
    low, high = image[row, column].astype(int)
    assert low[2] > low[0] and high[0] > high[2], "blue is low, red is high"


@pytest.mark.parametrize("size", [(30.0, 10.0), (10.0, 30.0)])
def test_world_file_places_every_pixel_in_the_map(rng, size):
    points = np.column_stack([rng.uniform(0, size[0], 500), rng.uniform(0, size[1], 500), np.zeros(500)]).astype("f4")
    view = top_view(points, points.astype(float))
    a, d, b, e, c, f = (float(line) for line in world_file(view).splitlines())
    column, row = view.to_pixels(points.astype(float)).T - 0.5  # a world file counts from the middle of a pixel
    placed = np.stack([a * column + b * row + c, d * column + e * row + f], axis=1)
    np.testing.assert_allclose(placed, points[:, :2], atol=1e-5)


def test_picture_gets_its_scale_and_axes(rng):
    points = rng.uniform(0, 20, (500, 3)).astype(np.float32)
    view = top_view(points, points[:2].astype(float))
    plain = np.zeros((*view.shape, 3), np.uint8)
    drawn = lettered(plain, view)
    lit = (drawn == (238, 243, 248)).all(axis=2)
    assert not plain.any() and lit.any()
    rows = np.nonzero(lit[:, view.shape[1] // 2 :])[0]
    bar = max(np.ptp(np.nonzero(lit[row, view.shape[1] // 2 :])[0]) + 1 for row in np.unique(rows))
    length = round_length(view.shape[1] * view.pixel / 5.0)
    assert abs(bar * view.pixel - length) <= 1.5 * view.pixel


def test_small_picture_stays_plain():
    view = top_view(np.zeros((3, 3), np.float32), np.zeros((2, 3)))
    image = np.zeros((5, 5, 3), np.uint8)
    np.testing.assert_array_equal(lettered(image, view), image)


def test_picture_is_of_where_the_path_is(rng):
    near, far = rng.uniform(0, 10, (5000, 3)), rng.uniform(60, 120, (4000, 3))
    path = np.column_stack([np.linspace(2, 8, 20), np.full(20, 5.0), np.ones(20)])
    view = top_view(np.concatenate([near, far]).astype(np.float32), path)
    assert max(view.high) < 40.0
