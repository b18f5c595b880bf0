from __future__ import annotations

import base64
import json
import re
import shlex
import shutil
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clalign.cli.main import build_parser
from clalign.cli.match import options_from
from clalign.correspondence import Correspondence
from clalign.evaluation.errors import evaluate
from clalign.evaluation.truth import Truth
from clalign.mesh.landmarks import landmarks_of
from clalign.presentation.report import write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
SOFTWARE_WEBGL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
#: Root has no sandbox; a closed network must not be asked for updates.
QUIET = [
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="session")
def small_page(small: Correspondence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    known = np.flatnonzero(small.target_of_source >= 0)
    truth = Truth(known, np.roll(small.target_of_source[known], 1))
    write_report(small, path, evaluation=evaluate(small, truth, points=40))
    return path


@pytest.fixture(scope="session")
def large_page(large: Correspondence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("large-page") / "report.html"
    write_report(large, path)
    return path


def _array(page: str, name: str) -> np.ndarray:
    found = re.search(rf'id="array-{name}" data-type="(\w+)Array" data-shape="([\d,]+)">([^<]*)<', page)
    assert found
    kind, shape, text = found.groups()
    values = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=kind.lower())
    return values.reshape([int(count) for count in shape.split(",")])


def _facts(page: str) -> dict[str, Any]:
    found = re.search(r'id="facts">(.*?)</script>', page, flags=re.DOTALL)
    assert found
    return json.loads(found.group(1))


def test_page_holds_the_match_and_asks_for_nothing_else(small: Correspondence, small_page: Path) -> None:
    page = small_page.read_text(encoding="utf-8")
    facts = _facts(page)
    stored = _array(page, "target-positions") / 65535 * facts["target"]["span"] + facts["target"]["low"]
    distances = np.linalg.norm(stored[:, None] - stored[:50][None], axis=2)
    expected = np.linalg.norm(small.target.vertices[:, None] - small.target.vertices[:50][None], axis=2)
    assert np.abs(distances - expected).max() < 1e-4
    assert np.array_equal(_array(page, "map-0-target-of-source") + 1, small.target_of_source[1:])
    assert np.array_equal(_array(page, "source-numbers"), small.source.file_index)
    assert np.allclose(_array(page, "rotation"), small.rotation, atol=1e-6)
    assert facts["evaluation"]["mean"] > 0
    assert [shown["score"] for shown in facts["maps"]] == [small.score, small.alternatives[0].score]
    outside = re.findall(r'(?:src|href)="(?!data:)[^"]*"', re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL))
    assert outside == []
    assert "connect-src" not in page
    assert "default-src 'none'" in page


def test_text_from_outside_cannot_become_markup(small_page: Path) -> None:
    page = small_page.read_text(encoding="utf-8")
    assert "</script> is only text" not in page
    assert _facts(page)["warnings"] == ['the name <b>"x"</b> & </script> is only text']


def test_eigenfunctions_are_stored_to_half_a_level(small: Correspondence, small_page: Path) -> None:
    levels = _array(small_page.read_text(encoding="utf-8"), "source-after").astype(float)
    for row in (1, 7):
        values = small.source_aligned[:, row]
        limit = max(np.abs(values).max(), np.abs(small.target_aligned[:, row]).max())
        assert np.abs((levels[row] / 127.5 - 1) * limit - values).max() <= 0.51 * limit / 127.5


def test_agreement_is_better_after_than_before(small_page: Path) -> None:
    agreement = _facts(small_page.read_text(encoding="utf-8"))["functions"]["agreement"]
    assert np.mean(np.abs(agreement["after"])) > np.mean(np.abs(agreement["before"]))
    assert np.mean(agreement["after"]) > 0.8


def test_large_page_stays_small_by_showing_fewer_functions(large_page: Path) -> None:
    assert large_page.stat().st_size < 25e6
    facts = _facts(large_page.read_text(encoding="utf-8"))
    assert facts["functions"]["available"] == 100
    assert 20 <= facts["functions"]["shown"] < 100


def test_failed_writing_leaves_the_old_page(small: Correspondence, tmp_path: Path) -> None:
    with pytest.raises(OSError, match="none"):
        write_report(small, tmp_path / "none" / "report.html", functions=2)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    if CHROMIUM is None:
        pytest.skip("there is no Chromium here that could open the page")
    with sync_playwright() as started:
        running = started.chromium.launch(executable_path=CHROMIUM, args=[*SOFTWARE_WEBGL, *QUIET])
        yield running
        running.close()


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens a page; afterwards the browser must have had nothing to complain of and asked nothing of a network."""
    complaints: list[str] = []
    contexts = []

    def on_request(request: Any) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            complaints.append(f"request {request.url}")

    def on_console(message: Any) -> None:
        # Reading pixels back, which screenshots do, is slow: the driver says so and means nothing else.
        if message.type in ("error", "warning") and "GPU stall due to ReadPixels" not in message.text:
            complaints.append(f"{message.type}: {message.text}")

    def open_page(path: Path, width: int = 800, height: int = 600) -> Any:
        contexts.append(browser.new_context(viewport={"width": width, "height": height}))
        page = contexts[-1].new_page()
        page.on("console", on_console)
        page.on("pageerror", lambda error: complaints.append(f"exception: {error}"))
        page.on("request", on_request)
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-ready=yes]", timeout=90_000)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []


_DRAWN = """(side) => {
  // A drawn picture can be read only before the browser has shown it.
  views[side].draw();
  const canvas = views[side].canvas;
  const copy = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height });
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  let covered = 0;
  const colours = new Set();
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 200) continue;
    covered += 1;
    colours.add((data[i] >> 4) * 256 + (data[i + 1] >> 4) * 16 + (data[i + 2] >> 4));
  }
  return { share: covered / (data.length / 4), colours: colours.size };
}"""


def _drawn(page: Any, side: str) -> dict[str, float]:
    return page.evaluate(_DRAWN, side)


def _click_surface(page: Any, side: str) -> tuple[int, int]:
    page.click(f"#canvas-{side}", position=_surface_point(page, side))
    readout = page.locator("#readout")
    return int(readout.get_attribute("data-source")), int(readout.get_attribute("data-target"))


def _surface_point(page: Any, side: str) -> dict[str, float]:
    """A place of the canvas under which the shape lies: at the vertex nearest to the viewer."""
    return page.evaluate(
        """(side) => {
          const { camera, canvas, positions } = views[side];
          let nearest = null;
          for (let vertex = 0; vertex < positions.length / 3; vertex += 1) {
            const point = new THREE.Vector3().fromArray(positions, 3 * vertex).project(camera);
            if (nearest === null || point.z < nearest.z) nearest = point;
          }
          return { x: ((nearest.x + 1) / 2) * canvas.clientWidth, y: ((1 - nearest.y) / 2) * canvas.clientHeight };
        }""",
        side,
    )


def test_page_draws_and_answers_a_click(opened: Callable[..., Any], small: Correspondence, small_page: Path) -> None:
    page = opened(small_page)
    for side in ("source", "target"):
        drawn = _drawn(page, side)
        assert drawn["share"] > 0.05
        assert drawn["colours"] > 50
    source, target = _click_surface(page, "source")
    assert target == small.target_of_source[source]
    assert "local distortion" in page.inner_text("#readout")
    source, target = _click_surface(page, "target")
    assert source == small.source_of_target[target]
    page.keyboard.press("Escape")
    assert page.inner_text("#readout") == "No point chosen."


def _click_vertex(page: Any, side: str, vertex: int) -> int:
    """Click where a vertex of the page's arrays is drawn, from the side it faces; the file's number of what was hit."""
    place = page.evaluate(
        """([side, vertex]) => {
          const view = views[side];
          const normal = new THREE.Vector3().fromBufferAttribute(view.surface.geometry.getAttribute("normal"), vertex);
          const point = new THREE.Vector3().fromArray(view.positions, 3 * vertex);
          view.camera.position.copy(point).addScaledVector(normal, 3);
          view.controls.target.copy(point);
          view.controls.update();
          view.camera.updateMatrixWorld();
          const seen = point.clone().project(view.camera);
          return { x: ((seen.x + 1) / 2) * view.canvas.clientWidth, y: ((1 - seen.y) / 2) * view.canvas.clientHeight };
        }""",
        [side, vertex],
    )
    page.click(f"#canvas-{side}", position=place)
    return int(page.evaluate("([side, vertex]) => arrayValues(`${side}-numbers`)[vertex]", [side, vertex]))


def test_landmarks_are_clicked_saved_and_understood(
    opened: Callable[..., Any], small: Correspondence, small_page: Path, tmp_path: Path
) -> None:
    page = opened(small_page, width=1100, height=900)
    page.uncheck("#together")
    assert not page.locator("#landmark-use").is_visible()
    page.check("#marking")
    clicked = []
    for source, target in ((5, 40), (300, 200), (77, 500)):
        # The second pair begins on the target.
        order = [("source", source), ("target", target)]
        numbers = {
            side: _click_vertex(page, side, vertex) for side, vertex in (order if source != 300 else order[::-1])
        }
        clicked.append([numbers["source"], numbers["target"]])
    _click_vertex(page, "source", 9)
    assert "same point on the target" in page.inner_text("#landmark-state")
    page.keyboard.press("Escape")
    assert page.inner_text("#landmark-state") == "Click a point on either shape."
    page.click("button[aria-label='Remove p3']")
    rows = page.locator("#landmark-list tbody tr")
    assert [rows.nth(i).locator("td").nth(k).inner_text() for i in range(2) for k in (1, 2)] == [
        str(number) for pair in clicked[:2] for number in pair
    ]
    with page.expect_download() as download:
        page.click("#landmark-save")
    download.value.save_as(tmp_path / "landmarks.csv")
    read = landmarks_of(tmp_path / "landmarks.csv", small.source, small.target)
    assert read.names == ("p1", "p2")
    np.testing.assert_array_equal(small.source.file_index[read.source], [pair[0] for pair in clicked[:2]])
    np.testing.assert_array_equal(small.target.file_index[read.target], [pair[1] for pair in clicked[:2]])
    words = shlex.split(page.inner_text("#landmark-command code"))
    args = build_parser().parse_args(words[1:])
    assert args.landmarks == ["landmarks.csv"]
    assert Path(args.out) == small_page.parent.with_name(small_page.parent.name + "-landmarks")
    page.click("#landmark-command button")
    assert page.inner_text("#landmark-command button") in ("Copied", "Selected")
    page.uncheck("#marking")
    _click_vertex(page, "source", 5)
    assert int(page.get_attribute("#readout", "data-source")) == clicked[0][0]


def test_this_one_writes_the_command_that_takes_an_alternative(
    opened: Callable[..., Any], small: Correspondence, tmp_path: Path
) -> None:
    words = "mirror image: left and right are exchanged"
    other = replace(small.alternatives[0], relation=words)
    shown = replace(
        small,
        source=replace(small.source, path=str(tmp_path / "a body's scan.ply")),
        options=small.options.replace({"seed": 5, "search.alternatives": 1}),
        alternatives=(other,),
        equally_good=({"relation": words, "reversing": True, "order": 2, "moved": 0.9, "alternative": 1},),
    )
    folder = tmp_path / "result"
    folder.mkdir()
    write_report(shown, folder / "report.html")
    page = opened(folder / "report.html", width=1100, height=900)
    assert page.inner_text("#equals") == f"{words} (alternative 1)"
    page.click("button[aria-label='Take alternative 1']")
    commands = [shlex.split(text) for text in page.locator("#way-to-map code").all_inner_texts()]
    args = build_parser().parse_args(commands[0][1:])
    assert (args.source, args.start, args.start_map) == (tmp_path / "a body's scan.ply", str(folder), 1)
    assert args.orientation == "reversing"
    assert options_from(args) == small.options.replace({"seed": 5, "search.orientation": "reversing"})
    assert build_parser().parse_args(commands[1][1:]).map == 1


def test_hover_shows_the_match_and_forgets_it(
    opened: Callable[..., Any], small: Correspondence, small_page: Path
) -> None:
    page = opened(small_page)
    page.hover("#canvas-target", position=_surface_point(page, "target"))
    page.wait_for_selector("#readout[data-target]")
    target = int(page.get_attribute("#readout", "data-target"))
    assert int(page.get_attribute("#readout", "data-source")) == small.source_of_target[target]
    page.hover("h1")
    page.wait_for_selector("#readout:not([data-target])")


def test_controls_change_what_is_drawn(opened: Callable[..., Any], small: Correspondence, small_page: Path) -> None:
    page = opened(small_page)

    def picture() -> bytes:
        _drawn(page, "source")
        return page.locator("#canvas-source").screenshot()

    seen = [picture()]
    for colouring in ("checkered", "distortion", "function", "plain"):
        page.select_option("#colouring", colouring)
        seen.append(picture())
    page.select_option("#colouring", "function")
    page.fill("#function", "9")
    seen.append(picture())
    page.check("input[name=aligned][value=before]", force=True)
    seen.append(picture())
    assert len(set(seen)) == len(seen)
    page.fill("#lookup-number", "12")
    page.press("#lookup-number", "Enter")
    assert int(page.get_attribute("#readout", "data-target")) == small.target_of_source[12]
    page.select_option("#map", "1")
    assert int(page.get_attribute("#readout", "data-target")) == small.alternatives[0].target_of_source[12]
    page.fill("#lookup-number", "0")
    page.press("#lookup-number", "Enter")
    assert "no vertex 0" in page.inner_text("#readout")


def test_squares_lie_on_matched_points(opened: Callable[..., Any], small: Correspondence, small_page: Path) -> None:
    page = opened(small_page)
    page.select_option("#colouring", "checkered")
    places = {
        side: np.array(page.evaluate("side => [...views[side].surface.geometry.getAttribute('place').array]", side))
        for side in ("source", "target")
    }
    source, target = (places[side].reshape(-1, 2) for side in ("source", "target"))
    assert np.array_equal(source, target[small.target_of_source[1:] - 1])
    assert np.ptp(target, axis=0).max() == pytest.approx(24, rel=1e-4)
    page.select_option("#colouring", "position")
    assert page.evaluate("() => views.source.checkered.value") == 0


def test_views_turn_together_or_apart_by_keyboard(opened: Callable[..., Any], small_page: Path) -> None:
    page = opened(small_page)
    place = "(side) => views[side].camera.position.clone().sub(views[side].controls.target).toArray()"

    def apart() -> float:
        return float(np.linalg.norm(np.subtract(page.evaluate(place, "source"), page.evaluate(place, "target"))))

    start = page.evaluate(place, "target")
    page.focus("#canvas-source")
    page.keyboard.press("ArrowRight")
    assert apart() < 1e-9
    assert np.linalg.norm(np.subtract(page.evaluate(place, "target"), start)) > 0.1
    page.uncheck("#together")
    page.focus("#canvas-source")
    page.keyboard.press("ArrowRight")
    assert apart() > 0.1
    page.check("#together")
    assert apart() < 1e-9
    page.focus("#canvas-target")
    page.keyboard.press("0")
    assert np.allclose(page.evaluate(place, "source"), start, atol=1e-6)


@pytest.mark.parametrize("width", [360, 1100])
def test_nothing_sticks_out_of_the_window(opened: Callable[..., Any], small_page: Path, width: int) -> None:
    page = opened(small_page, width=width, height=800)
    page.select_option("#colouring", "function")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("#error svg").count() == 1
    assert page.locator("#history svg").count() >= 3
    assert page.locator("#matrices canvas").count() == 2


def test_every_control_has_a_name(opened: Callable[..., Any], small_page: Path) -> None:
    page = opened(small_page)
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("input, select, button, canvas[tabindex], svg[role], canvas[role]")]
          .filter((e) => !(e.getAttribute("aria-label") || e.labels?.length || e.textContent.trim()))
          .map((e) => e.outerHTML.slice(0, 80))"""
    )
    assert nameless == []


def test_large_page_draws_and_answers_a_click(
    opened: Callable[..., Any], large: Correspondence, large_page: Path
) -> None:
    page = opened(large_page)
    assert _drawn(page, "target")["share"] > 0.05
    source, target = _click_surface(page, "source")
    assert target == large.target_of_source[source]


_NO_WEBGL = """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more);
};
"""


def test_without_webgl_a_picture_stands_in(browser: Any, small_page: Path) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script(_NO_WEBGL)
    page.goto(small_page.as_uri())
    page.wait_for_selector("#failure:not([hidden])")
    assert page.locator("#fallback img").is_visible()
    assert not page.locator("#stage").is_visible()
    context.close()
