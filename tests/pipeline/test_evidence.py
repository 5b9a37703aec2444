"""Evidence sheets, from logs and tables made by the real writers."""

import json
import math
import re
from functools import partial
from html import unescape
from pathlib import Path
from urllib.parse import quote, unquote

import cv2
import mercantile
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.evidence.crops import ACCENT, cut, draw_crop, read_crops
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView, gather
from wayside.pipeline.evidence.maps import Projection, error_ellipse, panel_line
from wayside.pipeline.evidence.marks import OUTLINES, UNKNOWN, US, figures_of
from wayside.pipeline.evidence.sheet import BIG, LEFT, PROPORTION, TILE, TOP, WIDTH
from wayside.pipeline.evidence.write import write_evidence
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.pages import shortened
from wayside.pipeline.reviewing.review import find_review
from wayside.pipeline.running.run import RunRequest, run_log
from wayside.schemas.detections import SHAPES
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.settings import ReadSettings, Settings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, POSTS, PROFILE, SIGNS

from . import results
from .results import invoke, table_of, write_tables

IMAGES, SPACING_M = 6, 8.0

FACE = 200, 30, 40
STEM = "d & r#1"
NEAR, FAR, BARE = f"{STEM}-0001", f"{STEM}-0002", f"{STEM}-0003"


def face_box(frame):
    """Where every image shows its one red face."""
    return [60.0 + 4 * frame, 40.0, 76.0 + 4 * frame, 54.0]


def make_log(folder, name=f"{STEM}.mcap", images=IMAGES, broken=()):
    shown = []
    for frame in range(images):
        pixels = np.full((120, 160, 3), (90, 120 + frame, 90), np.uint8)
        x0, y0, x1, y1 = (int(edge) for edge in face_box(frame))
        pixels[y0:y1, x0:x1] = FACE
        shown.append(cv2.imencode(".png", pixels)[1].tobytes()[:60] if frame in broken else pixels)
    return results.make_log(folder / name, shown)


def sign_row(sign_id, **changes):
    seen = {"best_frame": 3, "best_box": face_box(3), "first_frame": 1, "last_frame": 3, "views": 3}
    place = {"x": 40.0, "y": -6.0, "z": 2.0, "right_m": 6.0, "down_m": -1.0, "ahead_m": 16.0}
    return results.sign_row(sign_id, log=STEM, **place | seen | changes)


KNOWN = {
    **{"confidence": 0.9, "color": "red", "color_distance": 0.5, "shape": "octagon"},
    **{"shape_distance": 1.5, "covariance": [0.09, 0.02, 0.0, 0.04, 0.0, 0.01]},
    **{"sigma_along_m": 0.3, "sigma_lateral_m": 0.2, "sigma_up_m": 0.1, "station_m": 40.0},
    **{"lateral_m": 6.0, "up_m": 2.5, "bottom_m": 2.1, "panel_width_m": 0.8},
    **{"panel_height_m": 0.7, "facing_deg": 0.0, "sigma_facing_deg": 20.0, "lon_deg": -98.5},
    **{"lat_deg": 38.5, "residual_px": 0.4},
}


def observation(sign_id, frame, number, verdict="sign"):
    seen = {"box": face_box(frame), "u_px": 68.0 + 4 * frame, "v_px": 47.0, "track_id": 0}
    about = {"sign_id": sign_id, "verdict": verdict, "residual_px": 0.1 * frame}
    return results.observation_row(frame, number, **seen | about)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return make_log(tmp_path_factory.mktemp("log"))


@pytest.fixture
def out(tmp_path, log):
    return write_result(tmp_path / "out", log)


@pytest.fixture(scope="module")
def sheets(tmp_path_factory, log):
    """The sheets of that result, not to be changed."""
    folder = write_result(tmp_path_factory.mktemp("result"), log)
    return write_evidence(folder, folder / "sheets")


def write_result(folder, log):
    far = {"color": "yellow", "shape": "diamond", "confidence": 0.3, "lateral_m": -9.0, "x": 60.0}
    far |= {"status": "uncertain", "best_frame": 5, "first_frame": 4, "last_frame": 5, "views": 2}
    signs = [sign_row(NEAR, **KNOWN), sign_row(FAR, **KNOWN | far), sign_row(BARE, x=20.0, y=3.0)]
    observations = [observation(NEAR, frame, frame) for frame in (1, 2, 3)]
    observations += [observation(NEAR, 4, 9, verdict="overlap")]
    observations += [observation(FAR, frame, 10 + frame) for frame in (4, 5)]
    frames = results.frame_rows(log, SPACING_M, y=0.0, z=1.5)
    settings = {"read": {"spacing_m": SPACING_M, "thin_m": 0.0}}
    about = {"log": log.name, "log_path": str(log), "world": "drive_start", "settings": settings}
    lens = {"fx": 150.0, "fy": 150.0, "cx": 80.0, "cy": 60.0, "distortion": []}
    about["camera"] = {"width": 160, "height": 120} | lens
    return write_tables(folder, signs, observations, frames, **about)


def change_run(out, **changes):
    file = out / "run.json"
    content = json.loads(file.read_text()) | changes
    file.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))


def change_rows(out, table, change):
    """Rewrite a table of a result after a change of the list of its rows."""
    rows = pq.read_table(out / table.file).to_pylist()
    change(rows)
    pq.write_table(table_of(table, rows), out / table.file)


def references(text):
    """Everything that a page refers to."""
    return [unescape(one) for one in re.findall(r'\s(?:src|href|action)="([^"]*)"', text)]


def cards(text):
    """The attributes of the cards of an index."""
    found = (re.findall(r'([a-z-]+)="([^"]*)"', one) for one in re.findall(r"<li ([^>]*)>", text))
    return [{name: unescape(value) for name, value in one} for one in found]


def test_every_sign_gets_a_sheet_and_a_card_of_the_same_bytes_each_time(sheets, out, tmp_path):
    pages = [f"{name}.html" for name in (NEAR, FAR, BARE)]
    assert [path.name for path in sheets.sheets] == pages
    shown = cards(sheets.index.read_text("utf-8"))
    assert [card["id"] for card in shown] == [NEAR, FAR, BARE]
    assert sheets.lost_views == 0
    written = sorted(path.name for path in sheets.index.parent.iterdir())
    assert written == sorted([*pages, "index.html"])
    write_evidence(out, tmp_path / "again")
    for path in (*sheets.sheets, sheets.index):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_sheets_of_signs_that_are_no_more_go_away(out, tmp_path):
    folder = tmp_path / "sheets"
    write_evidence(out, folder, png=True)
    (folder / "notes.html").write_text("<p>of the user</p>")
    change_rows(out, SIGNS, shorter)
    write_evidence(out, folder)
    left = {path.name for path in folder.iterdir()}
    assert left == {f"{NEAR}.html", f"{NEAR}.png", "index.html", "notes.html"}


def test_one_sign_gets_its_sheet_alone_and_the_command_says_what_to_open(out):
    said = results.invoke("evidence", out, "--sign", FAR)
    (sheet,) = (out / "evidence").iterdir()
    assert (said.split("\n")[-2], sheet.name) == (str(sheet), f"{FAR}.html")
    assert not re.search(r'rel="(prev|up|next)"', sheet.read_text("utf-8"))


def test_sheets_are_images_too_with_the_face_of_the_best_frame_large(out, tmp_path):
    for _ in range(2):  # its own are replaced
        written = write_evidence(out, tmp_path / "sheets", png=True)
    files = [str(path.with_suffix(".png")) for path in written.sheets]
    near, *others = (cv2.imread(file)[..., ::-1] for file in files)
    assert {image.shape[1] for image in (near, *others)} == {WIDTH}
    middle = near[TOP + BIG.height // 2, LEFT + BIG.width // 2]
    assert np.abs(middle.astype(int) - FACE).max() <= 2


def test_a_page_says_in_text_what_is_known_and_leads_to_its_neighbours(sheets):
    text = sheets.index.with_name(f"{FAR}.html").read_text("utf-8")
    links = references(text)
    near, index, bare = (quote(name) for name in (f"{NEAR}.html", "index.html", f"{BARE}.html"))
    assert [link for link in links if link.endswith(".html")] == [near, index, bare]
    assert sum(link.startswith("data:image/webp") for link in links) == 1 + 2
    assert len(re.findall(r'<svg class="map"', text)) == 3
    shown = re.sub(r"<(script|style|details)>.*?</\1>", "", text, flags=re.DOTALL)
    for words in ("yellow diamond", "38.5000000°", "± 0.30 m", "frame 4", "status uncertain"):
        assert words in shown
    assert "Mahalanobis" in text
    assert "Mahalanobis" not in shown
    assert "openstreetmap.org/?mlat=38.5000000&amp;mlon=-98.5000000" in text
    assert " UTC" in text


def test_the_name_of_an_image_is_shown_where_the_result_knows_it(out):
    change_rows(out, FRAMES, lambda rows: [row.update(image_name="IMG <3>.jpg") for row in rows])
    results.invoke("evidence", out, "--sign", NEAR)
    text = (out / "evidence" / f"{NEAR}.html").read_text("utf-8")
    assert "IMG &lt;3&gt;.jpg" in text
    assert " UTC" not in text
    assert "IMG <" not in text


def test_views_are_the_measured_ones_in_order_with_their_range_else_the_best_box(out):
    _, (near, _, bare) = gather(out, None)
    assert [view.frame for view in near.views] == [1, 2, 3]
    assert near.best.frame == 3
    assert near.views[0].range_m == pytest.approx(math.hypot(40 - 8, 6, 0.5))
    assert near.views[2].residual_px == pytest.approx(0.3)
    assert [(view.frame, list(view.box)) for view in bare.views] == [(3, face_box(3))]


@pytest.mark.parametrize(("made", "lost"), [({"broken": (0, 2)}, 1), ({"images": 4}, 2)])
def test_views_that_do_not_decode_or_that_the_log_lacks_are_left_empty(out, tmp_path, made, lost):
    words = results.invoke("evidence", out, "--log", make_log(tmp_path, **made), status=4)
    assert ["1 view has", "2 views have"][lost - 1] + " no image" in words
    assert len(list((out / "evidence").iterdir())) == 3 + 1


def with_fixes(rows, turn=0.0):
    for row in rows:
        east = row["x"] * math.cos(turn) - row["y"] * math.sin(turn)
        north = row["x"] * math.sin(turn) + row["y"] * math.cos(turn)
        row["lat_deg"] = 38.5 + north / 111e3
        row["lon_deg"] = -98.5 + east / (111e3 * math.cos(math.radians(38.5)))


@pytest.mark.parametrize("turn_deg", [0.0, 70.0, -160.0])
def test_north_is_up_on_all_maps_where_the_fixes_tell_it(out, tmp_path, sheets, turn_deg):
    """Of a drive whose own frame is turned against east by some angle; and of one without fixes."""
    assert ">north</text>" not in sheets.index.read_text("utf-8")
    assert gather(out, NEAR)[0].globe is None
    turn = math.radians(turn_deg)
    change_rows(out, FRAMES, partial(with_fixes, turn=turn))
    globe = gather(out, NEAR)[0].globe
    assert [1.0, 0.0] @ globe.turn == pytest.approx([math.cos(turn), math.sin(turn)], abs=0.0025)
    assert (globe.lon_deg, globe.lat_deg) == pytest.approx((-98.5, 38.5), abs=1e-7)
    assert 1 / globe.lat_deg_per_m == pytest.approx(111e3, rel=1e-3)
    for page in (lambda written: written.index, lambda written: written.sheets[0]):
        text = page(write_evidence(out, tmp_path / "sheets")).read_text("utf-8")
        assert ">north</text>" in text
        path = re.search(r'class="path" points="([^"]*)"', text)[1].split()
        (x0, y0), (x1, y1) = (map(float, point.split(",")) for point in (path[0], path[-1]))
        up = math.degrees(math.atan2(y0 - y1, x1 - x0))
        assert (up - turn_deg + 180) % 360 - 180 == pytest.approx(0, abs=0.5)


def later(rows):
    rows[3]["log_time_ns"] += 1


def shorter(rows):
    del rows[1:]


SETTINGS = r"run\.json: the settings .* run the log again"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda out: change_run(out, log_path=None), "does not state where it is. Name it with"),
        (lambda out: change_run(out, log_path="/gone.mcap"), r"the log /gone.mcap, .* --log"),
        (lambda out: change_rows(out, FRAMES, later), "not the log .* Frame 3 .* --log"),
        (lambda out: change_rows(out, FRAMES, shorter), "tables are of different runs"),
        *(
            (lambda out, name=name: (out / name).unlink(), f"no {name}; `wayside run")
            for name in ("run.json", SIGNS.file, FRAMES.file, OBSERVATIONS.file)
        ),
        *(
            (lambda out, content=content: (out / "run.json").write_bytes(content), r"run\.json")
            for content in (b"{", b"[]", b"[" * 100_000, b"\xff\xfe\x00")
        ),
        *(
            (lambda out, settings=settings: change_run(out, settings=settings), SETTINGS)
            for settings in ({}, {"read": {"spacing": 8.0}}, {"read": 3}, 4)
        ),
    ],
)
def test_a_result_that_is_not_whole_is_refused(out, tmp_path, spoil, words):
    spoil(out)
    with pytest.raises(InputError, match=words):
        write_evidence(out, tmp_path / "sheets")


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"sign_id": f"{STEM}-001"}, UsageError, f"Did you mean {NEAR}"),
        ({"log": Path(__file__).parent}, InputError, "which is a folder. Give a log with --log"),
    ],
)
def test_a_sign_or_log_that_is_none_is_refused(out, tmp_path, options, kind, words):
    with pytest.raises(kind, match=words):
        write_evidence(out, tmp_path / "sheets", **options)
    assert not (tmp_path / "sheets").exists()


def test_the_index_refers_to_nothing_but_the_sheets_beside_it(sheets):
    text = sheets.index.read_text("utf-8")
    ids = {card["id"] for card in cards(text)}
    for reference in references(text):
        if reference.startswith("#"):
            assert unquote(reference[1:]) in ids
        elif not reference.startswith("data:image/webp;base64,"):
            assert (sheets.index.parent / unquote(reference)).is_file()
    basemaps = re.findall(r'<option value="https:[^"]*"', text)
    assert len(basemaps) == len(re.findall(r"https?:|@import|url\(", text)) == 3


def test_cards_carry_what_the_filters_ask_for_and_the_summary_counts_as_the_run_does(sheets):
    text = sheets.index.read_text("utf-8")
    assert "<p>2 signs, 1 uncertain on 40 m of road, 6 images." in text
    names = ("color", "shape", "status", "confidence", "station")
    found = [[card[f"data-{name}"] for name in names] for card in cards(text)]
    near, far = ["red", "octagon", "sign", "0.9000"], ["yellow", "diamond", "uncertain", "0.3000"]
    assert found == [[*near, "40.000"], [*far, "40.000"], ["unknown", "unknown", "sign", "", ""]]


def test_the_address_keeps_the_filters_on_the_way_to_a_sign_and_back(out, tmp_path, in_browser):
    index = write_evidence(out, tmp_path / "sheets").index
    seen = in_browser(
        index,
        """
        const shown = () => document.getElementById("count").textContent;
        const found = [shown(), fields.color.value, cards.find(card => !card.hidden).querySelector("a").hash];
        fields.color.value = "yellow";
        fields.color.dispatchEvent(new Event("input", { bubbles: true }));
        found.push(shown(), location.hash);
        fields.color.value = "";  // what a browser makes of a form on the way back
        dispatchEvent(new PageTransitionEvent("pageshow"));
        found.push(shown(), fields.color.value);
        form.reset();
        await until(() => !location.hash);
        return [...found, shown(), location.hash];
        """,
        fragment="#color=red&sort=best",
    )
    assert seen == [
        *("1 of 3 shown", "red", "#color=red&sort=best"),
        *("1 of 3 shown", "#color=yellow&sort=best", "1 of 3 shown", "yellow"),
        *("3 of 3 shown", ""),
    ]
    links = "return Array.from(document.querySelectorAll('nav a'), link => link.hash);"
    back = in_browser(index.with_name(f"{FAR}.html"), links, fragment="#color=red")
    assert back == ["#color=red"] * 3


def test_previous_and_next_go_along_what_the_filters_show(out, tmp_path, in_browser):
    index = write_evidence(out, tmp_path / "sheets").index
    key = '"wayside " + new URL(".", location.href)'
    order, links = in_browser(
        index,
        f"""
        fields.status.value = "sign";
        fields.sort.value = "best";
        fields.sort.dispatchEvent(new Event("input", {{ bubbles: true }}));
        return [cards.filter(card => !card.hidden).map(card => card.id), JSON.parse(sessionStorage.getItem({key}))];
        """,
    )
    assert links == [[name, quote(f"{name}.html")] for name in order]
    assert len(order) == 2
    sheet = tmp_path / "sheets" / f"{order[0]}.html"
    asked = 'return Array.from(nav.querySelectorAll("a"), link => [link.rel, link.getAttribute("href")]);'
    stored = f"sessionStorage.setItem({key}, {json.dumps(json.dumps(links))});"
    body = f"<body><script>{stored}</script>"
    sheet.write_text(sheet.read_text("utf-8").replace("<body>", body), "utf-8")
    assert in_browser(sheet, asked, fragment="#status=sign") == [
        ["up", "index.html#status=sign"],
        ["next", f"{quote(order[1])}.html#status=sign"],
    ]


@pytest.mark.parametrize("width", [390, 1280])
def test_a_view_of_a_sheet_is_enlarged_and_put_back(sheets, in_browser, width):
    seen = in_browser(
        sheets.sheets[0],
        """
        const view = document.querySelector(".small figure button"), before = view.firstChild.width;
        view.click();
        const shown = large.querySelector("img");
        await until(() => shown.complete);
        press("ArrowRight");  // leads to no other sign now
        const found = [large.open, shown.src === view.firstChild.src, shown.width > 1.2 * before];
        const fits = shown.getBoundingClientRect().right <= innerWidth;
        found.push(fits, document.documentElement.scrollWidth <= innerWidth);
        shown.click();
        return [...found, large.open];
        """,
        width=width,
    )
    assert seen == [True] * 5 + [False]


def test_filters_are_folded_on_a_phone_until_asked_for(sheets, in_browser):
    seen = in_browser(
        sheets.index,
        """
        const visible = () => Array.from(form.querySelectorAll("label"), one => one.offsetParent !== null);
        const fold = at("fold");
        const found = [visible().some(Boolean), getComputedStyle(fold).display, fold.getAttribute("aria-expanded")];
        fold.click();
        return [...found, visible().every(Boolean), fold.getAttribute("aria-expanded")];
        """,
        width=390,
    )
    assert seen == [False, "block", "false", True, "true"]


@pytest.mark.parametrize("width", [390, 1280])
def test_a_sign_is_found_by_words_and_placed_by_a_tap_on_the_zoomed_map(
    out, tmp_path, in_browser, width
):
    """Dispatches what fingers do: a tap adds a sign, a drag moves the map and adds none, two fingers zoom."""
    measured = {"route": "K-18", "measure": 7.25, "measure_unit": "mi"}
    change_rows(out, SIGNS, lambda rows: rows[0].update(measured))
    change_rows(out, FRAMES, with_fixes)
    index = write_evidence(out, tmp_path / "sheets", units=US).index
    seen = in_browser(
        index,
        """
        const near = Array.from(byId.keys())[0], found = [];
        for (const words of ["k-18 7.2", "nowhere", ""]) {
          fields.find.value = words;
          fields.find.dispatchEvent(new Event("input", { bubbles: true }));
          found.push(cards.filter(card => !card.hidden).map(card => card.id));
        }
        const rect = () => dots.get(near).getBoundingClientRect();
        const before = rect(), bar = () => map.querySelector(".foot text").textContent, bars = [bar()];
        const touch = (kind, clientX, clientY, pointerId = 1) =>
          map.dispatchEvent(new PointerEvent(kind, { pointerId, clientX, clientY, bubbles: true }));
        const tap = (x, y, dx = 0) => {
          touch("pointerdown", x, y);
          for (const kind of ["pointermove", "pointerup"]) touch(kind, x + dx, y);
          map.dispatchEvent(new MouseEvent("click", { bubbles: true, cancelable: true, clientX: x + dx, clientY: y }));
        };
        const middle = one => [one.left + one.width / 2, one.top + one.height / 2];
        at("add").click();
        for (let i = 0; i < 12; i++) {
          const [clientX, clientY] = middle(rect());
          map.dispatchEvent(new WheelEvent("wheel", { deltaY: -100, clientX, clientY, cancelable: true }));
        }
        bars.push(bar());
        tap(...middle(rect()), 60);
        const dragged = missing.length;
        tap(...middle(rect()));
        const tiles = () => Array.from(map.querySelectorAll(".tiles image"), one => one.getAttribute("href"));
        const quiet = tiles(), base = document.querySelector(".zoom select");
        base.value = base.options[1].value;
        base.dispatchEvent(new Event("change"));
        const drawn = tiles(), whole = map.viewBox.baseVal.width, [x, y] = middle(map.getBoundingClientRect());
        const pinch = (kind, away) => [1, 2].forEach(id => touch(kind, x + (2 * id - 3) * away, y, id));
        pinch("pointerdown", 20); pinch("pointermove", 60);
        return { found, bars, dragged, missing, quiet, tiles: drawn, size: [before.width, rect().width],
          pinched: whole / map.viewBox.baseVal.width, wide: document.documentElement.scrollWidth - innerWidth };
        """,
        width=width,
    )
    assert seen["found"] == [[NEAR], [], [NEAR, FAR, BARE]]
    assert all(words.endswith(" ft") for words in seen["bars"])
    assert float(seen["bars"][0].split()[0]) > 4 * float(seen["bars"][1].split()[0])
    assert (seen["dragged"], seen["quiet"], seen["wide"] <= 0) == (0, [], True)
    (missing,) = seen["missing"]
    assert (missing["x"], missing["y"]) == pytest.approx((40.0, -6.0), abs=0.1)
    assert seen["size"][0] == pytest.approx(seen["size"][1], abs=1)  # dots keep their size
    assert seen["pinched"] == pytest.approx(3.0, rel=1e-3)
    east, north = 40.0, -6.0
    lat, lon = 38.5 + north / 111e3, -98.5 + east / (111e3 * math.cos(math.radians(38.5)))
    shown = {tuple(map(int, re.findall(r"\d+", one)[-3:])) for one in seen["tiles"]}
    assert any(mercantile.tile(lon, lat, level) == (x, y, level) for level, x, y in shown)


@pytest.mark.parametrize("width", [1300, 390])
def test_a_person_corrects_the_inventory_in_the_index(out, tmp_path, in_browser, width):
    change_run(out, files={SIGNS.file: {"sha256": "0" * 64}})
    index = write_evidence(out, tmp_path / "sheets", images=True).index
    profile = tmp_path / "profile"
    seen = in_browser(
        index,
        """
        const link = id => byId.get(id).querySelector("a");
        const [near, far, bare] = Array.from(byId.keys());
        const change = (id, name, value) => {
          const field = byId.get(id).querySelector(".say [name=" + name + "]");
          field.value = value;
          field.dispatchEvent(new Event("change", { bubbles: true }));
        };
        press("a", link(near)); press("r", link(far)); press("e", link(bare));
        change(bare, "code", "R1-1");  // of the catalogue: red, octagon
        change(bare, "legend", "4 WAY");
        change(bare, "color", "green");
        at("undo").click();
        press("e", link(far));
        document.body.dispatchEvent(new KeyboardEvent("keydown", { key: "z", ctrlKey: true, bubbles: true }));
        at("add").click();
        const dot = dots.get(near).getBoundingClientRect();
        const place = { clientX: dot.left + dot.width / 2, clientY: dot.top + dot.height / 2 };
        map.dispatchEvent(new MouseEvent("click", { bubbles: true, cancelable: true, ...place }));
        missing[0].note = '=a "stop", hidden';
        const type = one => { [at("measure").value, at("right").value] = one; at("here").requestSubmit(); };
        [[20, -4], [60, 3], [200, 0]].forEach(type);  // the last image is at 40
        await openImages();
        for (const step of [1, 2]) {  // a point that the second and the fourth camera see
          showImage(step);
          await until(() => at("view").clientHeight);
          const ahead = 40 - 8 * shown, edge = at("view").getBoundingClientRect();
          const [u, v] = [(80.5 + 150 * 6 / ahead) / 160, (60.5 - 150 * 0.5 / ahead) / 120];
          const where = { clientX: edge.left + u * edge.width, clientY: edge.top + v * edge.height };
          at("view").dispatchEvent(new MouseEvent("click", { bubbles: true, ...where }));
        }
        at("reviewer").value = "Ann";
        remember();
        fields.review.value = "rejected";
        fields.review.dispatchEvent(new Event("input", { bubbles: true }));
        const saved = asJson(), wide = document.documentElement.scrollWidth - innerWidth;
        await load(new File([saved], "review.json"));
        return { saved, same: asJson() === saved, shown: at("count").textContent, wide };
        """,
        profile=profile,
        width=width,
    )
    assert (seen["same"], seen["shown"], seen["wide"] <= 0) == (True, "1 of 3 shown", True)
    (tmp_path / "review.json").write_text(seen["saved"])
    review = find_review(out, [tmp_path / "review.json"])
    said = {name: one.review for name, one in review.rows.items()}
    assert said == {NEAR: "accepted", FAR: "rejected", BARE: "edited"}
    assert [*review.rows[BARE].look.values()] == ["R1-1", "4 WAY", "red", "octagon"]
    clicked, typed, beyond, sighted = review.missing
    assert (clicked.x, clicked.y) == pytest.approx((40.0, -6.0), abs=0.4)  # the dot of the sign
    assert (clicked.note, clicked.reviewer) == ('=a "stop", hidden', "Ann")
    assert (typed.x, typed.y, beyond.x, beyond.y) == pytest.approx((20.0, 4.0, 60.0, -3.0))
    assert (sighted.x, sighted.y) == pytest.approx((40.0, -6.0), abs=0.3)
    assert in_browser(index, "return rows().length;", profile=profile) == 7


@pytest.mark.parametrize("width", [1300, 390])
def test_what_reviewers_contradict_is_decided_in_the_index(out, tmp_path, in_browser, width):
    change_run(out, files={SIGNS.file: {"sha256": "0" * 64}})
    files = []
    for reviewer, review in (("Ann", "accepted"), ("Bob", "rejected")):
        files.append(tmp_path / f"{reviewer}.json")
        rows = [{"sign_id": name, "review": review} for name in (NEAR, FAR)]
        files[-1].write_text(json.dumps({"reviewer": reviewer, "reviews": rows}))
    index = write_evidence(out, tmp_path / "sheets", reviews=files).index
    seen = in_browser(
        index,
        """
        const asked = at("open").children.length, pictures = at("open").querySelectorAll("img").length;
        const wide = document.documentElement.scrollWidth - innerWidth;
        const press = n => at("open").children[0].querySelectorAll("button")[n].click();
        press(0); press(1); at("undo").click();
        return { asked, pictures, wide, left: at("open").children.length, saved: asJson() };
        """,
        width=width,
    )
    assert (seen["asked"], seen["left"]) == (2, 1)
    assert seen["wide"] <= 0
    (tmp_path / "review.json").write_text(seen["saved"])
    review = find_review(out, [tmp_path / "review.json"])
    said = {name: (one.review, one.reviewer) for name, one in review.rows.items()}
    assert said == {NEAR: ("accepted", "Ann")}
    (asked,) = review.undecided  # the one that is not decided is still asked about
    assert asked.words == f"{FAR}: reviewers disagree"


@given(
    box=st.tuples(st.integers(0, 140), st.integers(0, 100), st.integers(1, 20), st.integers(1, 20)),
    seed=st.integers(0, 9),
)
def test_a_crop_holds_the_pixels_of_its_box(box, seed):
    rgb = np.random.default_rng(seed).integers(0, 256, (120, 160, 3), np.uint8)
    x0, y0, width, height = box
    crop = cut(rgb, (x0, y0, x0 + width, y0 + height), PROPORTION)
    left, top, right, bottom = (int(edge) for edge in crop.box)
    assert (right - left, bottom - top) == (width, height)
    assert 0 <= left < right <= crop.rgb.shape[1]
    assert 0 <= top < bottom <= crop.rgb.shape[0]
    shown = crop.rgb[top:bottom, left:right]
    assert (shown == rgb[y0 : y0 + height, x0 : x0 + width]).all()
    assert crop.rgb.shape[1] / crop.rgb.shape[0] == pytest.approx(PROPORTION, abs=0.05)


@pytest.mark.parametrize("way", ["evidence --blur", "run --blur"])
def test_blurring_leaves_the_panel_alone_and_nothing_sharp_around_it(tmp_path, way):
    noise = np.random.default_rng(0).integers(0, 200, (120, 160, 3), np.uint8)
    shown = [noise + np.uint8(frame) for frame in range(IMAGES)]  # none is a duplicate
    out = write_result(tmp_path / "out", results.make_log(tmp_path / "n.mcap", shown))
    if way == "run --blur":
        change_run(out, settings={"read": {"spacing_m": SPACING_M, "thin_m": 0.0, "blur": True}})
    boxes = [("one", 3, tuple(face_box(3)))]
    ((_, crop),) = read_crops(out, None, boxes, PROPORTION, blur=way[0] == "e")
    left, top, right, bottom = (int(edge) for edge in crop.box)
    off = np.ones(crop.rgb.shape[:2], bool)
    off[top:bottom, left:right] = False
    assert (crop.rgb[~off] == shown[3][40:54, 72:88].reshape(-1, 3)).all()
    assert np.abs(np.diff(crop.rgb.astype(int), axis=1))[off[:, 1:] & off[:, :-1]].mean() < 15
    whole = cut(shown[3], face_box(3), PROPORTION).rgb.astype(int)
    assert np.abs(np.diff(whole, axis=1)).mean() > 60
    invoke("evidence", out, *(["--blur"] if way[0] == "e" else []))


def test_the_box_is_drawn_around_the_face_and_grey_around_an_image_smaller_than_the_crop():
    crop = cut(np.zeros((30, 40, 3), np.uint8), (10, 10, 30, 25), PROPORTION)
    assert (crop.rgb == 0).all(axis=2).sum() == 30 * 40
    assert crop.rgb.shape[0] > 30
    rgb = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    crop = cut(rgb, (70, 50, 90, 65), PROPORTION)
    drawn, scaled = draw_crop(crop, TILE), crop.scaled_to(*TILE)
    x0, y0, x1, y1 = (round(edge) for edge in scaled.box)
    inside = slice(y0 + 1, y1 - 1), slice(x0 + 1, x1 - 1)
    assert (drawn[inside] == scaled.rgb[inside]).all()
    rows, columns = np.nonzero((drawn == ACCENT).all(axis=2))
    found = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
    assert np.abs(found - scaled.box).max() < 7


def evidence_of(**changes):
    sign = sign_row("a-0001", **KNOWN | changes)
    return Evidence(sign, (SignView(0, (0.0, 0.0, 9.0, 9.0), None, None),))


@given(st.floats(0.05, 4), st.floats(0.05, 4), st.floats(-0.95, 0.95))
def test_the_error_ellipse_lies_two_sigmas_away_everywhere(sigma_x, sigma_y, correlation):
    xy = correlation * sigma_x * sigma_y
    evidence = evidence_of(covariance=[sigma_x**2, xy, 0, sigma_y**2, 0, 1])
    away = error_ellipse(evidence) - [40, -6]
    inverse = np.linalg.inv([[sigma_x**2, xy], [xy, sigma_y**2]])
    assert np.sqrt(np.einsum("ni,ij,nj->n", away, inverse, away)) == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize(
    ("facing_deg", "expected"),
    [(0.0, [0.0, 1.0]), (None, [0.0, 1.0]), (90.0, [1.0, 0.0]), (-30.0, [-0.5, math.sqrt(0.75)])],
)
def test_the_panel_is_as_wide_as_measured_and_turned_as_it_faces(facing_deg, expected):
    path = np.array([[8.0 * i, 0.0, 1.5] for i in range(8)])
    drive = DriveMap(dict(enumerate(path)), path, np.zeros((0, 3)), {})
    ends = panel_line(evidence_of(facing_deg=facing_deg, panel_width_m=0.8), drive)
    assert ends.mean(axis=0) == pytest.approx([40.0, -6.0])
    assert (ends[1] - ends[0]) / 0.8 == pytest.approx(expected)


@given(st.lists(st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)), min_size=1, max_size=20))
def test_a_map_shows_all_its_points_above_its_scale_bar(points):
    page = Projection(np.array(points), (480, 340), 20.0)(np.array(points))
    assert (page >= 0).all()
    assert (page[:, 0] <= 480).all()
    assert (page[:, 1] <= 340 - 40).all()


def test_every_shape_has_an_outline():
    assert set(OUTLINES) == set(SHAPES)
    assert all(np.abs(outline).max() <= 1 for outline in OUTLINES.values())


def figures(**changes):
    sign = dict.fromkeys(column.name for column in SIGNS.columns) | sign_row("a-0001", **changes)
    return [figure for group in figures_of(sign, "enu").values() for figure in group]


def test_what_is_not_known_is_said_to_be_unknown_and_a_route_is_told_where_it_is_known():
    unknown = {figure.label for figure in figures() if figure.value == UNKNOWN}
    assert {"Along the road", "Colour", "Width", "Facing", "Residual, RMS"} <= unknown
    assert not any("None" in figure.value + figure.remark for figure in figures())
    assert "Route" not in {figure.label for figure in figures()}
    known = figures(route="US-36 EB", measure=12.3456, measure_unit="mi")
    assert known[0].value == "US-36 EB, 12.346 mi"


def test_pages_take_a_milepost_and_feet_that_the_run_did_not_have(out):
    results.invoke("evidence", out, "--units", "us", "--route", "K-18", "--milepost", "7")
    text = (out / "evidence" / f"{NEAR}.html").read_text("utf-8")
    for words in ("K-18, 7.025 mi", "131.23 ft", "± 0.98 ft", "31.5 in"):  # of 40 m, 0.3 m, 0.8 m
        assert words in text
    assert " m<" not in text
    assert "K-18, 7.025 mi" in (out / "evidence" / "index.html").read_text("utf-8")


def test_nothing_is_less_than_zero_by_less_than_is_shown():
    values = {f.label: f.value for f in figures(facing_deg=-0.3, bottom_m=-0.004)}
    assert (values["Facing"], values["Lower edge above it"]) == ("0°", "0.00 m")


def test_the_standard_size_of_a_diamond_is_told_along_its_sides_and_across():
    inches = {"nominal_width_in": 30.0, "nominal_height_in": 30.0, "shape": "diamond"}
    values = {f.label: f.value for f in figures(**inches, mutcd="W", code_probability=1.0)}
    assert values["Standard size"] == "30 x 30 in along its sides, 42 in across"


def test_the_ground_below_a_sign_is_that_between_the_strips_around_it(out):
    assert {one.sign["ground_m"] for one in gather(out, None)[1]} == {None}
    near = [(36.0, 5.5, -0.5), (36.0, 6.5, -0.9), (44.0, 5.5, -0.7), (44.0, 6.5, -1.1)]
    far, hidden = (60.0, 6.0, 3.0), (40.0, 6.0, 9.0)
    strips = [
        {"station_m": station, "offset_m": offset, "height_m": height, "count": 2, "frame": 3}
        | {"status": "hidden" if (station, offset, height) == hidden else "ground"}
        for station, offset, height in [*near, far, hidden]
    ]
    pq.write_table(table_of(PROFILE, strips), out / PROFILE.file)
    beside, other, bare = gather(out, None)[1]
    assert beside.sign["ground_m"] == pytest.approx(-0.8)
    assert (other.sign["ground_m"], bare.sign["ground_m"]) == (None, None)
    values = {f.label: f.value for group in figures_of(beside.sign, "").values() for f in group}
    assert values["and above the ground below"] == "2.90 m"


def test_a_sign_says_what_its_support_stands_on(out):
    assert {one.sign["posts"] for one in gather(out, None)[1]} == {None}
    row = {"assembly_id": FAR, "sign_id": FAR, "kind": "round_metal", "number": 2}
    row |= {"width_m": 0.061, "sigma_width_m": 0.008, "views": 2, "frame": 3}
    row |= dict.fromkeys("xyz", 0)
    pq.write_table(table_of(POSTS, [row]), out / POSTS.file)
    shown = [
        [(f.value, f.remark) for f in figures_of(one.sign, "")["Position"] if "Stands" in f.label]
        for one in gather(out, None)[1]
    ]
    assert shown.count([("round metal, 2 posts", "0.06 m ± 0.01 m wide")]) == 1
    assert shown.count([]) == len(shown) - 1


@pytest.mark.parametrize("most", [5, 14, 30, 2000])
def test_long_words_are_cut_in_the_middle(most):
    words = "a_very_long_name_of_a_drive_2026-11-21_front_camera-0001"
    short = shortened(words, most)
    assert len(short) <= most
    assert (short[0], short[-1]) == ("a", "1")
    assert short == words or "..." in short


def test_a_run_notes_its_log_and_makes_pages_of_an_earlier_result_say_so(
    tmp_path, log, monkeypatch
):
    monkeypatch.chdir(log.parent)
    out = tmp_path / "out"
    settings = Settings(read=ReadSettings(spacing_m=SPACING_M, thin_m=0.0))
    asked = RunRequest(Path(log.name), out, settings, load_models(settings), overwrite=True)
    run_log(asked)
    assert json.loads((out / "run.json").read_text())["log_path"] == str(log)
    written = write_evidence(out, out / "evidence")
    assert len(written.sheets) == pq.read_metadata(out / SIGNS.file).num_rows
    results.invoke("export", out, "-f", "csv")
    assert run_log(asked).older == ()  # the same signs
    change_run(out, files={SIGNS.file: {"sha256": "0" * 64}})
    assert run_log(asked).older == ("signs.csv", "evidence/index.html")
    assert "from an earlier result" in written.index.read_text("utf-8")
    write_evidence(out, out / "evidence")
    assert "of an earlier result" not in written.index.read_text("utf-8")


@pytest.mark.parametrize(
    "name", ["../../X", "/tmp/X", "..", "a\x00b", "a/b", "a\\b", "\x1b[2J", "x" * 300, ""]
)
def test_an_id_that_leads_out_of_the_folder_is_refused_and_nothing_is_written(out, tmp_path, name):
    change_rows(out, SIGNS, lambda rows: rows[0].update(sign_id=name))
    before = {path for path in tmp_path.rglob("*")}
    with pytest.raises(InputError, match="cannot name a file"):
        write_evidence(out, out / "evidence")
    assert {path for path in tmp_path.rglob("*")} == before


def test_links_in_a_strangers_folder_are_not_followed(out, tmp_path):
    mine = tmp_path / "mine"
    mine.write_text("precious")
    sheets = out / "evidence"
    with pytest.raises(OutputError, match="Choose another folder with -o"):
        write_evidence(out, mine)
    sheets.symlink_to(tmp_path)
    with pytest.raises(UsageError):
        results.invoke("evidence", out)
    sheets.unlink()
    sheets.mkdir()
    for name in (f"{NEAR}.html", f".{NEAR}.html.part", "index.html", ".index.html.part"):
        (sheets / name).symlink_to(mine)
    with pytest.raises(OutputError, match="not evidence of this log"):
        write_evidence(out, sheets)
    write_evidence(out, sheets, overwrite=True)
    assert mine.read_text() == "precious"
    assert not (sheets / f"{NEAR}.html").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "out"]
