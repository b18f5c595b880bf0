"""Every malformed mesh gives its own finding, with the numbers of the file, and repair makes a usable mesh of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import malformed
import numpy as np
import pytest
import shapes
from malformed import Malformed

from clalign.errors import MeshError
from clalign.mesh import checks, gluing, surface_checks, topology
from clalign.mesh.checks import diagnose
from clalign.mesh.defects import Severity, Surface
from clalign.mesh.examination import Examination
from clalign.mesh.gluing import glued
from clalign.mesh.mesh import load_mesh, mesh_from_arrays
from clalign.mesh.repair import repair

CASES = malformed.surfaces()


def case_id(case: Malformed) -> str:
    return case.name.replace(" ", "-")


@pytest.mark.parametrize("strict", [False, True], ids=["", "strictly"])
@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_each_defect_is_found_and_named(case: Malformed, strict: bool) -> None:
    diagnosis = diagnose(case.vertices, case.faces, strict=strict)
    refused = case.refused_strictly if strict else case.refused
    found = {defect.kind: defect for defect in diagnosis.defects}
    assert case.kind in found, list(found)
    defect = found[case.kind]
    assert set(case.numbers) <= {*defect.vertices, *defect.faces}
    assert (defect.severity is Severity.REFUSED) == refused
    assert bool(diagnosis.refused) == refused, "one defect must not be reported as another"
    if refused:
        with pytest.raises(MeshError, match=r"Way out: \w|Way out: `") as error:
            mesh_from_arrays(case.vertices, case.faces, "thing", strict=strict)
        assert str(error.value).startswith("thing: ")
        assert defect.problem in str(error.value)
    else:
        mesh = mesh_from_arrays(case.vertices, case.faces, strict=strict)
        assert len(mesh.notes) == sum(d.severity is Severity.HANDLED for d in diagnosis.defects)
        np.testing.assert_allclose(mesh.file_vertices(), case.vertices[mesh.file_index], atol=1e-12)


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_repair_makes_a_usable_mesh_or_says_why_not(case: Malformed) -> None:
    if not case.repairable:
        with pytest.raises(MeshError, match="cannot be repaired"):
            repair(case.vertices, case.faces)
        return
    repaired = repair(case.vertices, case.faces)
    mesh = mesh_from_arrays(repaired.vertices, repaired.faces)
    assert repaired.notes or case.kind == "boundary"
    assert mesh.n_vertices == len(repaired.vertices)
    np.testing.assert_array_equal(repaired.vertices, case.vertices[repaired.file_index])
    # Every triangle of the result lies where one of the mesh does; at most its direction has changed.
    sound = case.faces[((case.faces >= 0) & (case.faces < len(case.vertices))).all(axis=1)]
    given = {tuple(sorted(map(tuple, face))) for face in case.vertices[sound].tolist()}
    if case.name != "point cloud":
        assert {tuple(sorted(map(tuple, face))) for face in repaired.vertices[repaired.faces].tolist()} <= given


def test_a_sound_mesh_has_no_findings_and_is_not_changed_by_repair() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    diagnosis = diagnose(vertices, faces)
    assert diagnosis.defects == ()
    assert (diagnosis.euler_characteristic, diagnosis.genus, diagnosis.boundary_loops) == (2, 0, 0)
    repaired = repair(vertices, faces)
    assert repaired.notes == ()
    np.testing.assert_array_equal(repaired.vertices, vertices)
    np.testing.assert_array_equal(repaired.faces, faces)


def test_handles_and_boundaries_are_counted() -> None:
    vertices, faces = malformed.strip(30, 2)
    diagnosis = diagnose(vertices, faces)
    assert (diagnosis.euler_characteristic, diagnosis.genus, diagnosis.boundary_loops) == (0, 0, 2)
    u, v = np.meshgrid(np.arange(20), np.arange(12), indexing="ij")
    tube = 3 + np.cos(2 * np.pi * v / 12)
    angle = 2 * np.pi * u / 20
    torus = np.stack([tube * np.cos(angle), tube * np.sin(angle), np.sin(2 * np.pi * v / 12)], axis=-1).reshape(-1, 3)
    a, b = (u * 12 + v).ravel(), (((u + 1) % 20) * 12 + v).ravel()
    c, d = (((u + 1) % 20) * 12 + (v + 1) % 12).ravel(), (u * 12 + (v + 1) % 12).ravel()
    diagnosis = diagnose(torus, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    assert (diagnosis.euler_characteristic, diagnosis.genus, diagnosis.boundary_loops) == (0, 1, 0)


def test_repair_keeps_the_body_when_it_cuts_the_fin() -> None:
    vertices, faces = malformed.sphere()
    fin = next(case for case in CASES if case.name == "fin")
    repaired = repair(fin.vertices, fin.faces)
    np.testing.assert_array_equal(repaired.file_index, np.arange(len(vertices)))
    np.testing.assert_array_equal(repaired.faces, faces)


def finned(body: malformed.Arrays) -> malformed.Arrays:
    """A body with a small fin on every edge."""
    vertices, faces = body
    edges = topology.edge_table(faces, len(vertices)).edges
    fins = np.column_stack([edges, len(vertices) + np.arange(len(edges))])
    return np.concatenate([vertices, 1.1 * vertices[edges].mean(axis=1)]), np.concatenate([faces, fins])


def test_repair_keeps_the_body_among_fins_on_every_edge() -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    repaired = repair(*finned((vertices, faces)))
    np.testing.assert_array_equal(repaired.file_index, np.arange(len(vertices)))
    np.testing.assert_array_equal(repaired.faces, faces)


def test_repair_keeps_the_body_and_drops_the_wall_inside() -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    above = vertices[faces].mean(axis=1)[:, 2] > 0
    rim = topology.boundary_edges(faces[above], len(vertices))
    wall = np.column_stack([rim, np.full(len(rim), len(vertices))])
    repaired = repair(np.concatenate([vertices, [[0.0, 0, 0]]]), np.concatenate([faces, wall]))
    np.testing.assert_array_equal(repaired.file_index, np.arange(len(vertices)))
    np.testing.assert_array_equal(repaired.faces, faces)


@pytest.mark.parametrize("half_turns", [1, 3])
def test_repair_opens_a_moebius_strip_along_one_cut(half_turns: int) -> None:
    vertices, faces = malformed.strip(40, half_turns)
    repaired = repair(vertices, faces)
    diagnosis = diagnose(repaired.vertices, repaired.faces)
    assert (diagnosis.boundary_loops, diagnosis.euler_characteristic) == (1, 1)
    assert len(repaired.faces) == len(faces)


def test_triangles_with_vertices_of_their_own_are_joined() -> None:
    vertices, faces = malformed.sphere()
    soup = vertices[faces].reshape(-1, 3)
    corners = np.arange(len(soup)).reshape(-1, 3)
    with pytest.raises(MeshError, match=r"320 separate pieces.*--merge"):
        mesh_from_arrays(soup, corners, strict=True)
    mesh = mesh_from_arrays(soup, corners)
    assert (mesh.n_vertices, mesh.n_faces) == (len(vertices), len(faces))
    np.testing.assert_allclose(mesh.file_positions(), soup, atol=1e-12)
    for repaired in (repair(soup, corners), repair(soup, corners, merge=True)):
        assert (len(repaired.vertices), len(repaired.faces)) == (len(vertices), len(faces))
        assert diagnose(repaired.vertices, repaired.faces).genus == 0


def test_bodies_that_touch_with_inner_vertices_stay_two() -> None:
    first, faces = malformed.sphere()
    touching = np.concatenate([first, first[np.argmax(first[:, 0])] * 2 - first])
    both = np.concatenate([faces, faces + len(first)])
    with pytest.raises(MeshError, match="2 of them of similar size"):
        mesh_from_arrays(touching, both)
    assert mesh_from_arrays(touching, both, component=1).n_vertices == len(first)


def test_repair_survives_random_damage(rng: np.random.Generator) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    for _ in range(60):
        damaged = faces.copy()
        chosen = rng.choice(len(faces), size=rng.integers(1, 40), replace=False)
        damaged[chosen, rng.integers(0, 3, len(chosen))] = rng.integers(-2, len(vertices) + 2, len(chosen))
        extra = rng.integers(0, len(vertices), size=(rng.integers(0, 30), 3))
        repaired = repair(vertices, np.concatenate([damaged, extra]))
        assert not diagnose(repaired.vertices, repaired.faces).refused
        assert len(repaired.faces) > 150


def test_the_message_names_the_file_the_place_and_the_way_out(tmp_path: Path) -> None:
    fin = next(case for case in CASES if case.name == "fin")
    path = shapes.write_off(tmp_path / "my fin.off", fin.vertices, fin.faces)
    with pytest.raises(MeshError) as error:
        load_mesh(path, strict=True)
    a, b, _ = fin.faces[-1]
    message = str(error.value)
    assert message.startswith(
        f"{path}: 1 edge belongs to more than two faces (vertices {min(a, b)}, {max(a, b)}; faces "
    )
    assert message.endswith(f"Way out: `clalign check '{path}' --repair OUT` writes a repaired copy.")


def test_arrays_of_other_shapes_and_types_are_refused() -> None:
    vertices, faces = malformed.sphere()
    for bad_vertices, bad_faces in [
        (vertices[:, :2], faces),
        (vertices.ravel(), faces),
        (vertices.astype(str), faces),
        (vertices + 1j, faces),
        (vertices, faces + 0.5),
        (vertices, np.where(faces == 3, np.nan, faces)),
        (vertices, np.column_stack([faces, faces[:, 0]])),
        (vertices, [[0, 1, 2], [0, 1]]),
    ]:
        with pytest.raises(MeshError, match=r"thing: (vertices|faces) (have|must)"):
            mesh_from_arrays(bad_vertices, bad_faces, "thing")


def test_float_and_unsigned_face_numbers_are_taken() -> None:
    vertices, faces = malformed.sphere()
    expected = mesh_from_arrays(vertices, faces).faces
    for kind in (np.float32, np.uint32, np.int16, np.uint64):
        np.testing.assert_array_equal(mesh_from_arrays(vertices.tolist(), faces.astype(kind)).faces, expected)


def seconds(action: Callable[[], object]) -> float:
    """Processor time of one run, which other programs on the machine do not disturb."""
    start = time.process_time()
    action()
    return time.process_time() - start


def test_time_grows_with_the_size_not_its_square() -> None:
    def check(columns: int) -> None:
        mesh_from_arrays(*malformed.grid(200, columns))

    def many_duplicates(faces: int) -> None:
        soup = np.tile(np.eye(3), (faces, 1))
        with pytest.raises(MeshError, match="only 3 vertices"):
            mesh_from_arrays(soup, np.arange(len(soup)).reshape(-1, 3))

    def untangle(subdivisions: int) -> None:
        repair(*finned(shapes.bumpy_sphere(subdivisions)))

    check(10)
    for action, small in [(check, 60), (many_duplicates, 20_000)]:
        few, many = seconds(lambda: action(small)), seconds(lambda: action(16 * small))  # noqa: B023
        assert many < 64 * max(few, 0.01)
    assert seconds(lambda: untangle(5)) < 64 * max(seconds(lambda: untangle(3)), 0.01)


def beside(body: malformed.Arrays, other: malformed.Arrays) -> malformed.Arrays:
    """Return two meshes as one, without a common vertex."""
    return np.concatenate([body[0], other[0]]), np.concatenate([body[1], other[1] + len(body[0])])


def test_a_loose_ball_is_carried_along_and_refused_strictly() -> None:
    vertices, faces = malformed.sphere()
    both = beside((vertices, faces), (0.15 * vertices + np.array([1.5, 0, 0]), faces))
    mesh = mesh_from_arrays(*both)
    assert mesh.n_vertices == len(vertices)
    np.testing.assert_array_equal(mesh.loose.file_index, len(vertices) + np.arange(len(vertices)))
    np.testing.assert_allclose(mesh.file_positions(), both[0], atol=1e-12)
    with pytest.raises(MeshError, match=r"2 separate pieces, the largest with 97.8 %"):
        mesh_from_arrays(*both, strict=True)
    assert repair(*both).file_index.max() < len(vertices)
    np.testing.assert_array_equal(repair(*both, component=2).file_index, mesh.loose.file_index)


@pytest.mark.parametrize(("component", "rows"), [(1, slice(162, 324)), (2, slice(0, 162))])
def test_a_piece_is_chosen_by_its_size(component: int, rows: slice) -> None:
    """The other body is of similar size, so that it is left out, not carried along."""
    vertices, faces = malformed.sphere()
    both = beside((0.9 * vertices + np.array([4.0, 0, 0]), faces), (vertices, faces))
    mesh = mesh_from_arrays(*both, component=component)
    np.testing.assert_array_equal(mesh.file_index, np.arange(324)[rows])
    assert not len(mesh.loose.file_index)
    assert (mesh.vertex_of_file >= 0).sum() == 162
    with pytest.raises(MeshError, match="there is no piece 3: the mesh has 2 pieces"):
        mesh_from_arrays(*both, component=3)


def test_an_edge_that_is_divided_on_one_side_is_closed() -> None:
    vertices, faces = malformed.sphere()
    a, b, c = faces[0]
    new = len(vertices)
    divided = np.concatenate([faces[1:], [[a, new, c], [new, b, c]]])
    points = np.concatenate([vertices, [0.5 * (vertices[a] + vertices[b])]])
    diagnosis = diagnose(points, divided)
    assert (diagnosis.boundary_loops, diagnosis.genus) == (0, 0)
    assert [defect.kind for defect in diagnosis.defects] == ["t-junction"]
    assert diagnosis.defects[0].vertices == (new,)
    assert "in the middle of an open edge" in diagnosis.notes[0]
    assert diagnosis.surface is not None
    assert len(diagnosis.surface.faces) == len(faces) + 2
    strictly = diagnose(points, divided, strict=True)
    assert (strictly.boundary_loops, strictly.notes) == (1, ())


def test_a_small_part_with_one_side_is_cut_open() -> None:
    vertices, faces = malformed.sphere()
    strip, strip_faces = malformed.strip(40, 1)
    both = beside((vertices, faces), (0.25 * strip + np.array([1.5, 0, 0]), strip_faces))
    mesh = mesh_from_arrays(*both)
    assert mesh.n_vertices == len(vertices)
    assert len(mesh.loose.file_index) == len(strip)
    assert any("80 faces are in a part with only one side" in note and "cut open" in note for note in mesh.notes)
    with pytest.raises(MeshError, match="separate pieces"):
        mesh_from_arrays(*both, strict=True)


@pytest.mark.parametrize("far", [1e8, 1e12, 5e15, 2e16, 1e30])
def test_vertices_far_away_are_named(far: float) -> None:
    """Beside them the others have no area, and thin faces between them would have one that is lost in rounding."""
    vertices, faces = malformed.sphere(1)
    vertices[[3, 20]] = [far, 0.4 * far, 0.0], [0.7 * far, -far, far]
    with pytest.raises(MeshError, match=r"2 vertices lie so far away that the rest has no area .*\(vertices 3, 20\)"):
        mesh_from_arrays(vertices, faces)


@pytest.mark.parametrize("length", [1.0, 1e3, 1e6])
def test_the_area_is_one_however_thin_the_surface_is(length: float) -> None:
    vertices, faces = malformed.strip(400, 0)
    mesh = mesh_from_arrays(vertices * [length, length, 1.0] + [0.0, 3.0 * length, 5.0], faces)
    assert topology.face_areas(mesh.vertices, mesh.faces).sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(
        mesh.file_vertices(), vertices * [length, length, 1.0] + [0.0, 3.0 * length, 5.0], atol=1e-9 * length
    )


def test_what_no_number_of_rounds_mends_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """No mesh is known that the rounds are too few for, so there are none of them here."""
    monkeypatch.setattr(gluing, "_PASSES", 0)
    monkeypatch.setattr(checks, "_ROUNDS", 0)
    cases = {case.name: case for case in CASES}
    fin = cases["fin"]
    assert glued(Surface.whole(fin.vertices, fin.faces)).left == 3
    exam = Examination(Surface.whole(fin.vertices, fin.faces))
    surface_checks.check_manifold(exam)
    assert exam.refused
    assert "of several sheets could not be parted" in exam.defects[-1].problem
    bare = cases["vertex without area"]
    exam = Examination(Surface.whole(bare.vertices, bare.faces))
    checks._put_right(exam)
    assert exam.refused
    assert "without area again" in exam.defects[-1].problem
