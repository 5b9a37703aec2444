"""The codes of the signs of the demo log."""


def codes(result):
    return [row["mutcd"] for row in result.signs if row["status"] == "sign"]


def test_the_default_preset_tells_the_codes_of_the_demo(default_demo):
    assert codes(default_demo) == ["R2-1", "R1-1", "D", "TTC", "S1-1", "S", "W", "D9", "D"]
    assert default_demo.about["us_probability"] > 0.99
    limit = next(row for row in default_demo.signs if row["mutcd"] == "R2-1")
    assert limit["legend"] == "45"
    stop = next(row for row in default_demo.signs if row["mutcd"] == "R1-1")
    assert (stop["nominal_width_in"], stop["nominal_height_in"]) == (36, 36)


def test_the_classes_of_preset_report_tell_series(report_demo):
    assert any(codes(report_demo))
