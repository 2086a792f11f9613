"""Test the page "Try your cloud" in a real browser without a network: each kind of file in, each control, each way out.

    make check-book

The lines of Python that the page shows are run by the Python of `.venv`, or of TOPOKIT_PYTHON.
"""

from __future__ import annotations

import io
import json
import math
import os
import random
import struct
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_in_browser import BOOK, CHAPTERS, CHROMIUM, MOVE, OVERFLOW, ROOT, SETTLED, SHOWN, Visit, chromium  # noqa: F401

pytest.importorskip("playwright", reason="Playwright is not installed: make check-book")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not CHAPTERS, reason=f"no book in {BOOK}: make book"),
]
PAGE = "book/try.html"
PYTHON = Path(os.environ.get("TOPOKIT_PYTHON", ROOT / ".venv" / "bin" / "python"))

# ---- files of a ring of 60 points, which has one loop: born at half a side, dead at half the side of a triangle within


def ring(radius: float = 1.0, height: float = 3.0) -> list[tuple[float, float, float]]:
    turns = [2 * math.pi * k / 60 for k in range(60)]
    return [
        tuple(struct.unpack("<3f", struct.pack("<3f", radius * math.cos(t), radius * math.sin(t), height)))
        for t in turns
    ]


def triples(points: Any, code: str = "<3f") -> bytes:
    return b"".join(struct.pack(code, *point) for point in points)


def rows(separator: str, start: str = "", points: Any = None) -> bytes:
    return "".join(start + separator.join(map(repr, p)) + "\n" for p in points or ring()).encode()


def npy(points: Any = None, shape: str = "60, 3") -> bytes:
    head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}".ljust(117) + "\n"
    return (
        b"\x93NUMPY\1\0"
        + struct.pack("<H", len(head))
        + head.encode()
        + b"".join(struct.pack("<3f", *p) for p in points or ring())
    )


def npz(method: int) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        archive.writestr("points.npy", npy())
    return packed.getvalue()


def ply(kind: str, code: str = "") -> bytes:
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex 60\n"
        + "".join(f"property float {axis}\n" for axis in "xyz")
        + "end_header\n"
    )
    return head.encode() + (triples(ring(), code) if code else rows(" "))


def pcd(kind: str) -> bytes:
    head = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA {kind}\n".encode()
    if kind == "ascii":
        return head + rows(" ")
    if kind == "binary":
        return head + triples(ring())
    columns = b"".join(struct.pack("<60f", *axis) for axis in zip(*ring(), strict=True))
    runs = b"".join(bytes([len(part) - 1]) + part for part in (columns[k : k + 32] for k in range(0, 720, 32)))
    return head + struct.pack("<2I", len(runs), 720) + runs


def stl(binary: bool) -> bytes:
    corners = [ring()[3 * k : 3 * k + 3] for k in range(20)]
    if binary:
        faces = [struct.pack("<12fH", 0, 0, 1, *sum(three, ()), 0) for three in corners]
        return bytes(80) + struct.pack("<I", 20) + b"".join(faces)
    facets = [
        b"facet normal 0 0 1\nouter loop\n" + rows(" ", "vertex ", three) + b"endloop\nendfacet\n" for three in corners
    ]
    return b"solid ring\n" + b"".join(facets) + b"endsolid ring\n"


FILES = {
    "text.ply": ply("ascii"),
    "little.ply": ply("binary_little_endian", "<3f"),
    "big.ply": ply("binary_big_endian", ">3f"),
    "text.pcd": pcd("ascii"),
    "binary.pcd": pcd("binary"),
    "packed.pcd": pcd("binary_compressed"),
    "plain.npy": npy(),
    "plain.npz": npz(zipfile.ZIP_STORED),
    "packed.npz": npz(zipfile.ZIP_DEFLATED),
    "named.csv": b"x,y,z\n" + rows(","),
    "semicolons.csv": rows(";"),
    "blanks.xyz": rows(" "),
    "tabs.txt": rows("\t", points=[(*p, 1.0) for p in ring()]),
    "counted.pts": b"60\n" + rows(" "),
    "list.json": json.dumps(ring()).encode(),
    "mesh.obj": rows(" ", "v ") + b"f 1 2 3\n",
    "text.stl": stl(binary=False),
    "binary.stl": stl(binary=True),
}
BAD = {
    "empty.npy": b"",
    "cut.ply": FILES["little.ply"][:-9],
    "greedy.ply": FILES["little.ply"].replace(b"vertex 60", b"vertex 4000000000"),
    "no_places.ply": FILES["text.ply"].replace(b"float x", b"float u"),
    "words.csv": b"x,y\n1,2\none,two\n",
    "ragged.txt": b"1 2 3\n4 5\n",
    "cut.pcd": FILES["packed.pcd"][:-9],
    "objects.npy": npy().replace(b"<f4", b"|O "),
    "one_column.npy": npy(shape="180, 1"),
    "cut.npz": FILES["packed.npz"][:-30],
    "changed.npz": FILES["plain.npz"].replace(b"NUMPY", b"NUMPI"),
    "one_line.xyz": b"1.5 " * 5000,
    "none.obj": b"f 1 2 3\n",
    "pointer.ply": b"version https://git-lfs.github.com/spec/v1\n",
    "cut.stl": FILES["text.stl"][:-30],
    "picture.png": b"\x89PNG",
    "lost.xyz": b"nan nan nan\n0 0 0\n",
    **{
        f"garbage.{kind}": random.Random(0).randbytes(300_000)
        for kind in ("ply", "pcd", "npy", "npz", "csv", "obj", "stl")
    },
}


# ---- the page under the hand


class Cloud:
    """The page, and what it shows."""

    def __init__(self, visit: Visit) -> None:
        self.visit = visit
        [self.frame] = visit.figures()
        self.wait()

    def wait(self) -> None:
        self.frame.wait_for_function("document.querySelector('#busy').hidden && document.querySelector('#rows')")
        self.frame.evaluate(SETTLED)

    def give(self, files: dict[str, bytes]) -> None:
        given = [{"name": name, "mimeType": "", "buffer": content} for name, content in files.items()]
        self.frame.set_input_files("#files", given)
        self.frame.evaluate(SETTLED)
        self.wait()

    def text(self, selector: str) -> str:
        return str(self.frame.query_selector(selector).inner_text())

    def shown(self) -> Any:
        self.frame.evaluate(SETTLED)
        return self.frame.evaluate(SHOWN)

    def pressed(self) -> str:
        return self.text("#rows [aria-pressed=true]")

    def choose_sample(self, name: str) -> None:
        self.frame.select_option("#sample", name)
        self.frame.evaluate(SETTLED)
        self.wait()

    def saved(self, button: str) -> bytes:
        with self.visit.page.expect_download() as download:
            self.frame.click(button)
        return Path(download.value.path()).read_bytes()


@pytest.fixture
def cloud(chromium: Any) -> Iterator[Cloud]:  # noqa: F811
    with Visit(chromium, PAGE, accept_downloads=True, permissions=["clipboard-read", "clipboard-write"]) as visit:
        yield Cloud(visit)
        assert visit.trouble == []


def test_each_bad_file_is_named_with_what_is_wrong_and_the_picture_stays(cloud: Cloud) -> None:
    for name, content in BAD.items():
        before = cloud.shown()
        cloud.give({name: content})
        assert cloud.text("#errors").startswith(f"{name}: "), name
        assert not any(
            word in cloud.text("#errors") for word in ("undefined", "NaN", "null", "Offset", "not a function")
        )
        assert cloud.shown() == before
    assert cloud.visit.violations() == []
    cloud.give({"plain.npy": FILES["plain.npy"]})
    assert cloud.text("#errors") == ""


def test_a_file_of_300_mb_is_refused_at_once(cloud: Cloud) -> None:
    cloud.frame.evaluate("""() => {
      const files = new DataTransfer();
      files.items.add(new File(Array(300).fill(new Uint8Array(2 ** 20)), "huge.ply"));
      document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true }));
    }""")
    cloud.frame.wait_for_function("document.querySelector('#errors').textContent.startsWith('huge.ply: 300 MB')")


@pytest.mark.parametrize("place", ["the figure", "the page around it"])
def test_files_are_dropped(cloud: Cloud, place: str) -> None:
    target = cloud.frame if place == "the figure" else cloud.visit.page
    target.evaluate(
        """text => {
          const files = new DataTransfer();
          files.items.add(new File([text], "dropped.csv"));
          document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
        }""",
        FILES["named.csv"].decode(),
    )
    cloud.frame.wait_for_function("document.querySelector('#told').textContent.includes('dropped.csv: 60 points')")


def test_what_is_left_out_is_counted(cloud: Cloud) -> None:
    cloud.give({"cloud.csv": FILES["named.csv"] + rows(",", points=ring()[:2]) + b"0,0,0\nnan,1,2\n,1,2\n"})
    assert "65 points; left out: 2 not finite, 1 at zero, where a camera saw nothing, 2 repeated" in cloud.text("#told")


def test_numbers_are_pasted(cloud: Cloud) -> None:
    cloud.frame.click("#paste")
    cloud.frame.fill("#numbers", rows(" ").decode())
    cloud.frame.click("#pasting button")
    cloud.frame.wait_for_function("document.querySelector('#told').textContent.includes('pasted.txt: 60 points')")
    cloud.wait()
    assert cloud.pressed() == "loop 0"


@pytest.mark.parametrize(
    "numbers", ["1 2 3", "1 2\n3 4", "0 0 1\n0 0 2\n0 0 3\n0 0 4", "1e300 0 0\n0 1e300 1\n1 1 1", "1 2 3\n1 2 3"]
)
def test_few_points_have_no_loops_and_cause_no_trouble(cloud: Cloud, numbers: str) -> None:
    cloud.give({"few.txt": numbers.encode()})
    assert "sample" not in cloud.text("#told")
    assert cloud.text("#rows") == ""
    assert "0 loops" in cloud.text("#status")
    cloud.frame.query_selector("#radius").evaluate(MOVE)
    assert "edges" in (cloud.shown() and cloud.text("#status"))


def test_every_sample_shows_its_loops(cloud: Cloud) -> None:
    samples = cloud.frame.evaluate("[...document.querySelector('#sample').options].map((option) => option.value)")
    assert len(samples) == 8
    loops = {}
    for sample in samples:
        cloud.choose_sample(sample)
        assert f"sample: {sample}" in cloud.text("#told")
        loops[sample] = cloud.text("#rows").count("loop ")
    assert loops["noise without a loop"] == 0
    assert loops["a trefoil"] == loops["a mug's handle"] == loops["an apron"] == loops["a tote bag"] == 1
    assert loops["a torus"] == loops["a mask"] == 2


@pytest.mark.parametrize("sample", ["a mask", "a film: an apron and its hook"])
def test_every_control_does_something(cloud: Cloud, sample: str) -> None:
    cloud.choose_sample(sample)
    used = []
    for name in ("radius", "points", "next", "before", "time", "play", "help", "paste"):
        control = cloud.frame.query_selector(f"#{name}")
        if not control.is_visible():
            continue
        used.append(name)
        before = cloud.shown() + str(cloud.frame.is_visible("#pasting"))
        if name in ("radius", "points", "time"):
            control.evaluate(MOVE)
        else:
            control.click()
        if name == "play":
            cloud.visit.page.wait_for_timeout(400)
            control.click()
        cloud.wait()
        assert cloud.shown() + str(cloud.frame.is_visible("#pasting")) != before, name
    assert ("play" in used) == ("film" in sample)
    before = cloud.shown()
    cloud.frame.click("#reset")
    assert cloud.shown() != before


def test_keys_alone_do_all_of_it(cloud: Cloud) -> None:
    keyboard = cloud.visit.page.keyboard
    cloud.frame.focus("#choose")
    reached = []
    for _ in range(20):
        reached.append(cloud.frame.evaluate("document.activeElement.id || document.activeElement.tagName"))
        keyboard.press("Tab")
    wanted = [
        "choose",
        "paste",
        "sample",
        "scene",
        "diagram",
        "radius",
        "points",
        "help",
        "copy",
        "python",
        "save-json",
    ]
    assert [name for name in reached if name in wanted] == wanted

    # The loops, by the keys of the diagram, of the cloud, and by the buttons of the table.
    cloud.frame.focus("#diagram")
    keyboard.press("ArrowDown")
    assert cloud.shown()
    assert cloud.pressed() == "bar 1"
    cloud.frame.focus("#scene")
    for key in ("ArrowLeft", "ArrowUp", "+", "n"):
        before = cloud.shown()
        keyboard.press(key)
        assert cloud.shown() != before, key
    assert cloud.pressed() == "bar 2"
    cloud.frame.focus("#rows [tabindex='0']")
    keyboard.press("ArrowUp")
    keyboard.press("ArrowUp")
    assert cloud.shown()
    assert cloud.pressed() == "loop 0"


def test_table_and_diagram_choose_the_same_loop(cloud: Cloud) -> None:
    cloud.choose_sample("a mask")
    before = cloud.shown()
    cloud.frame.click("#rows tr:nth-child(2)")
    assert cloud.shown() != before
    assert cloud.pressed() == "loop 1"
    label = str(cloud.frame.get_attribute("#diagram", "aria-label"))
    assert "chosen is loop 1: born 0.0" in label
    box = cloud.frame.query_selector("#diagram").bounding_box()
    for share in range(30, 60):  # down a column of the diagram until its highest dot is met
        cloud.frame.click("#diagram", position={"x": box["width"] * share / 100, "y": 40})
        cloud.frame.evaluate(SETTLED)
        if cloud.pressed() == "loop 0":
            return
    pytest.fail("no click on the diagram chose loop 0")


def film() -> dict[str, bytes]:
    """Return a ring that shrinks, frame by frame; the order of names is natural."""
    return {f"frame{k}.npy": npy(ring(1 - 0.01 * k)) for k in (10, 9, 8, 2, 1)}


def test_a_film_keeps_the_names_of_its_loops(cloud: Cloud) -> None:
    cloud.give(film())
    assert "frame1.npy to frame10.npy: 5 frames, 300 points" in cloud.text("#told")
    frames = json.loads(cloud.saved("#save-json"))["frames"]
    assert [[loop["name"] for loop in frame["loops"]] for frame in frames] == [["loop 0"]] * 5
    deaths = [frame["loops"][0]["death"] for frame in frames]
    assert deaths == sorted(deaths, reverse=True)
    cloud.frame.click("#next")
    assert "frame 1 of 4" in (cloud.shown() and cloud.text("#status"))
    strip = cloud.frame.query_selector("#strip")
    strip.click(position={"x": strip.bounding_box()["width"] - 20, "y": 60})
    assert "frame 4 of 4" in (cloud.shown() and cloud.text("#status"))


def test_a_film_is_stopped_and_the_page_goes_on(cloud: Cloud) -> None:
    seen = ring(1) + ring(2) + ring(3) + ring(4)
    shape = f"300, {len(seen)}, 3"
    cloud.frame.set_input_files("#files", [{"name": "long.npy", "mimeType": "", "buffer": npy(seen * 300, shape)}])
    running = "(stop, done) => stop.textContent === 'stop tracking' && done.value > 0"
    cloud.frame.wait_for_function(f"({running})(document.querySelector('#stop'), document.querySelector('#done'))")
    cloud.frame.click("#stop")
    assert not cloud.frame.is_visible("#busy")
    cloud.choose_sample("a torus")
    assert "sample: a torus" in cloud.text("#told")
    assert cloud.pressed() == "loop 0"


# ---- out


def assert_ring(cloud: Cloud, name: str, loops: list[dict[str, Any]]) -> None:
    """Assert that the page shows the one loop of the ring."""
    assert cloud.text("#errors") == ""
    assert f"{name}: 60 points" in cloud.text("#told")
    assert cloud.frame.evaluate("document.querySelector('#sample').selectedIndex") == -1
    [loop] = loops
    assert loop["name"] == "loop 0"
    assert loop["birth"] == pytest.approx(math.sin(math.pi / 60), rel=1e-5)
    assert loop["death"] == pytest.approx(math.sin(math.pi / 3), rel=1e-5)
    assert sorted(loop["cycle"]) == list(range(60))
    assert "yes, clearly" in cloud.text("#rows tr")


def by_python(code: str, folder: Path, then: str) -> Any:
    """Run the page's lines, as a reader would, beside the files; return what `then` prints as JSON."""
    if not PYTHON.exists():
        pytest.skip(f"no {PYTHON}: make env")
    command = [str(PYTHON), "-c", f"{code}\nimport json\nprint(json.dumps({then}))"]
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", [*FILES, "spoilt.csv", "many.npy", "plane.npy", "a torus"])
def test_the_lines_of_python_give_the_loops_of_each_kind_of_file(cloud: Cloud, tmp_path: Path, name: str) -> None:
    chance = random.Random(1)
    strewn = [tuple(chance.gauss(0, 1) for _ in range(3)) for _ in range(900)]
    more = {
        "spoilt.csv": b"# from a camera\n"
        + rows(",", points=[*ring(), *ring()[5:9]])
        + b"0,0,0\nnan,1,2\n,1,2\n70,0,0\n",
        "many.npy": npy(strewn, "900, 3"),
        "plane.npy": npy(strewn, "1350, 2"),
    }
    if name in FILES | more:
        (tmp_path / name).write_bytes((FILES | more)[name])
        cloud.give({name: (FILES | more)[name]})
    else:
        cloud.choose_sample(name)
        (tmp_path / "a_torus.npy").write_bytes(cloud.saved("#save-points"))
    found = json.loads(cloud.saved("#save-json"))["frames"][0]
    if name in FILES:
        assert_ring(cloud, name, found["loops"])
    births, deaths, places = by_python(
        cloud.text("#python"),
        tmp_path,
        "[diagram.birth.tolist(), diagram.death.tolist(), points[diagram.killer_triangles].tolist()]",
    )
    assert [loop["birth"] for loop in found["loops"]] == births
    assert [loop["death"] for loop in found["loops"]] == deaths
    shown = [
        [[found["points"][v][: len(places[0][0][0])] for v in three] for three in loop["killer_triangles"]]
        for loop in found["loops"]
    ]
    assert shown == places


def test_a_plane_and_what_is_outside_a_box_are_taken_away_and_put_back(cloud: Cloud, tmp_path: Path) -> None:
    chance = random.Random(2)
    table = [(chance.uniform(-6, 6), chance.uniform(-6, 6), 0.5) for _ in range(2000)]
    far = [(k, 0, 9) for k in range(20)]
    scene = npy([*ring(0.3, 0.9), *table, *far], "2080, 3")
    (tmp_path / "scene.npy").write_bytes(scene)
    cloud.give({"scene.npy": scene})
    assert cloud.text("#hint") == "No loop? Crop, or remove the plane."
    cloud.frame.click("#crop")
    cloud.frame.query_selector_all("#box input")[5].evaluate("""slider => {
      for (const name of ["input", "change"]) (slider.value = 190, slider.dispatchEvent(new Event(name)));
    }""")
    cloud.wait()
    cloud.frame.click("#plane")
    cloud.wait()
    assert cloud.text("#told").endswith("left out: 20 outside the box, 2,000 on a plane")
    [loop] = json.loads(cloud.saved("#save-json"))["frames"][0]["loops"]
    assert by_python(cloud.text("#python"), tmp_path, "diagram.death.tolist()") == [loop["death"]]
    cloud.frame.click("#whole")
    cloud.wait()
    assert cloud.text("#told") == "scene.npy: 2,080 points"


@pytest.mark.parametrize("name", ["an episode", "several files", "a film: an apron and its hook"])
def test_the_lines_of_python_track_the_same_film(cloud: Cloud, tmp_path: Path, name: str) -> None:
    if name == "an episode":
        episode = (ROOT / "data_small" / "apron_hook_1.npz").read_bytes()
        (tmp_path / "apron_hook_1.npz").write_bytes(episode)
        cloud.give({"apron_hook_1.npz": episode})
    elif name == "several files":
        for file, content in film().items():
            (tmp_path / file).write_bytes(content)
        cloud.give(film())
    else:
        cloud.choose_sample(name)
        (tmp_path / "a_film_an_apron_and_its_hook.npy").write_bytes(cloud.saved("#save-points"))
    lines = cloud.saved("#save-csv").decode().splitlines()[1:]
    shown = [
        (int(row[0]), row[1], float(row[2]), float(row[3]))
        for row in (line.split(",") for line in lines)
        if row[1].startswith("loop")
    ]
    states = (
        "[(t, f'loop {loop.id}', loop.birth, loop.death) for t, state in enumerate(states) for loop in state.loops]"
    )
    assert [list(row) for row in shown] == by_python(cloud.text("#python"), tmp_path, states)


def test_a_link_restores_the_view_of_a_sample(cloud: Cloud, chromium: Any) -> None:  # noqa: F811
    cloud.choose_sample("a mask")
    cloud.frame.query_selector("#points").evaluate("e => { e.value = 300; e.dispatchEvent(new Event('input')); }")
    cloud.wait()
    cloud.frame.click("#rows tr:nth-child(2)")
    cloud.frame.query_selector("#radius").evaluate("e => { e.value = 90; e.dispatchEvent(new Event('input')); }")
    cloud.frame.focus("#scene")
    cloud.visit.page.keyboard.press("ArrowLeft")
    cloud.frame.click("#link")
    address = cloud.text("#address")
    # The page copies it after the click has returned.
    cloud.visit.page.wait_for_function(
        "text => navigator.clipboard.readText().then((copied) => copied === text)", arg=address
    )
    picture = "[...document.querySelectorAll('canvas')].map((canvas) => canvas.toDataURL())"
    cloud.shown()
    with Visit(chromium, PAGE, asking="#" + address.partition("#")[2]) as visit:
        again = Cloud(visit)
        assert again.text("#told") == cloud.text("#told")
        assert again.pressed() == cloud.pressed() == "loop 1"
        assert again.text("#status").rpartition(" \u00b7 ")[0] == cloud.text("#status").rpartition(" \u00b7 ")[0]
        assert again.frame.evaluate(picture) == cloud.frame.evaluate(picture)
        assert visit.trouble == []


def test_the_picture_is_saved(cloud: Cloud) -> None:
    assert cloud.saved("#save-png").startswith(b"\x89PNG\r\n")


def test_the_code_is_copied(cloud: Cloud) -> None:
    cloud.frame.click("#copy")
    cloud.frame.wait_for_function("document.querySelector('#copy').textContent === 'copied'")
    assert cloud.visit.ask("() => navigator.clipboard.readText()") == cloud.text("#python")


def test_on_a_phone_a_finger_turns_the_cloud(chromium: Any) -> None:  # noqa: F811
    with Visit(chromium, PAGE, 400, has_touch=True) as visit:
        cloud = Cloud(visit)
        assert not visit.ask(OVERFLOW)
        assert not cloud.frame.evaluate(OVERFLOW)
        before = cloud.shown()
        cloud.frame.query_selector("#scene").scroll_into_view_if_needed()
        cloud.frame.evaluate("""() => {
          const scene = document.querySelector("#scene"), finger = { pointerId: 1, pointerType: "touch", bubbles: true };
          const touch = (type, clientX, clientY) => scene.dispatchEvent(new PointerEvent(type, { ...finger, clientX, clientY }));
          scene.setPointerCapture = () => {};
          touch("pointerdown", 100, 200);
          touch("pointermove", 160, 210);
          touch("pointerup", 160, 210);
        }""")
        assert cloud.shown() != before
        assert visit.trouble == []
