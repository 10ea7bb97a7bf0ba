from heliograph.errors import closest


def test_closest_suggests_the_nearest_name():
    assert "'voxel'" in closest("voxle", ["voxel", "range"])


def test_closest_is_silent_when_nothing_is_near():
    assert closest("qqqq", ["voxel", "range"]) == ""
