"""What the viewer says of rows once all signs are known."""

from wayside.pipeline.view.chains import inventory_table, sign_figures


def row(**change):
    lengths = ("station_m", "lateral_m", "up_m", "panel_width_m", "panel_height_m", "sigma_along_m")
    told = {"sign_id": "d-0001", "log": "d", "status": "sign", "color": "red", "shape": "octagon"}
    return told | dict.fromkeys(lengths, 1.5) | {"views": 4, "confidence": 0.9} | change


def test_a_row_is_headed_by_what_it_looks_like():
    assert sign_figures(row()).startswith("# d-0001: red octagon\n")
    assert sign_figures(row(color=None, shape=None)).startswith("# d-0001: ? ?\n")
    behind = row(status="back", color=None)
    assert sign_figures(behind).startswith("# d-0001: back octagon\n")
    assert "| d-0001 |  | back | octagon | 1.50 |" in inventory_table([behind])
