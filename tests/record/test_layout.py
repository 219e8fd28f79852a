"""What every run file holds."""

from __future__ import annotations

import hashlib
from dataclasses import fields, replace
from typing import TYPE_CHECKING

import h5py
import pytest

from edmctl.record import layout, rows
from edmctl.record.reader import open_run
from edmctl.record.rows import EventRow, profile_leaves, unit_of
from edmctl.record.writer import RunWriter
from edmctl.results.telemetry import PulseBlockBatch

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.record.rows import RunMeta


def test_every_described_path_exists_and_nothing_else_does(run_path: Path) -> None:
    described = {group.path for group in layout.GROUPS} | {scalar.path for scalar in layout.SCALARS}
    for table in layout.TABLES:
        described.add(table.path)
        if not table.is_compound:
            described |= {f"{table.path}/{column.name}" for column in table.columns}
    for grid in layout.GRIDS:
        described |= {grid.path, *(f"{grid.path}/{c.name}" for c in (grid.signal, *grid.axes))}
    plotted = (layout.DEFAULT_AXIS, layout.DEFAULT_SIGNAL, *layout.DEFAULT_AUXILIARY)
    described |= {f"{layout.DEFAULT_PLOT}/{name}" for name in plotted}
    found: set[str] = set()

    def visit(path: bytes) -> None:
        found.add("/" + path.decode())

    with h5py.File(run_path) as file:
        file.id.links.visit(visit)
    assert found == described


def test_every_dataset_has_a_unit_and_a_name(run_path: Path) -> None:
    bare: list[str] = []

    def visit(path: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset) and not {"units", "long_name"} <= set(item.attrs):
            bare.append(path)

    with h5py.File(run_path) as file:
        file.visititems(visit)
        assert file["/entry/servo/z_sensor"].attrs["units"] == "um"
        assert len(file["/entry/touches"].attrs["units"]) == len(file["/entry/touches"].dtype.names)
    assert bare == []


def test_no_text_of_a_dataset_lies_in_the_global_heap(run_path: Path) -> None:
    heaped: list[str] = []

    def visit(path: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.hasobject:
            heaped.append(path)

    with h5py.File(run_path) as file:
        file.visititems(visit)
        kind = h5py.check_string_dtype(file["/entry/profile/toml"].dtype)
        assert (kind.encoding, kind.length) == ("utf-8", len(b"# a comment\n[servo]\nreference = 0.80\n"))
    assert heaped == []


def test_texts_beyond_ascii_are_read_as_they_were_written(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", replace(meta, title="Größe Ø 270 µm", user=""))
    writer.append(EventRow(1.0, 100, rows.EventLevel.INFO, "55 µm → 60 µm"))
    path = writer.finish("done", 0)
    with open_run(path) as run:
        assert run.text("/entry/title") == "Größe Ø 270 µm"
        assert run.text("/entry/user/name") == ""
    with h5py.File(path) as file:
        assert file["/entry/title"].asstr()[()] == "Größe Ø 270 µm"
        assert h5py.check_string_dtype(file["/entry/events"].dtype["message"]).encoding == "utf-8"
        assert file["/entry/events"][0]["message"].decode() == "55 µm → 60 µm"


@pytest.mark.parametrize("table", [table for table in layout.TABLES if table.nx_class == "NXdata"])
def test_a_group_of_columns_says_what_viewers_plot(run_path: Path, table: layout.Table) -> None:
    units = {column.name: column.units for column in table.columns}
    with h5py.File(run_path) as file:
        attributes = file[table.path].attrs
        assert attributes["signal"] == table.signal
        assert list(attributes.get("axes", [])) == (["time"] if "time" in units else [])
        assert {units[name] for name in attributes.get("auxiliary_signals", [])} <= {units[table.signal]}


@pytest.mark.parametrize(
    ("table", "row"),
    [
        (layout.SERVO, rows.ServoBlock),
        (layout.SLOW, rows.SlowRow),
        (layout.PULSE_BLOCKS, PulseBlockBatch),
        (layout.TOUCHES, rows.TouchRow),
    ],
)
def test_every_value_of_a_row_is_stored_once(
    table: layout.Table, row: type[rows.ServoBlock | rows.SlowRow]
) -> None:
    stored = [column.field for column in table.columns]
    assert sorted(stored) == sorted(field.name for field in fields(row))


def test_the_default_plot_is_found_from_the_root(run_path: Path) -> None:
    with h5py.File(run_path) as file:
        entry = file[file.attrs["default"]]
        plot = entry[entry.attrs["default"]]
        assert plot.attrs["NX_class"] == "NXdata"
        assert plot[plot.attrs["signal"]] == file["/entry/servo/z_sensor"]
        assert plot[plot.attrs["axes"][0]] == file["/entry/servo/time"]
        names = list(plot.attrs["auxiliary_signals"])
        assert names == ["z_model"]
        assert all(plot[name] == file[f"/entry/servo/{name}"] for name in names)


@pytest.mark.parametrize("path", ["/entry/servo", "/entry/slow", "/entry/pulses/blocks"])
def test_time_is_the_dimension_scale_of_every_signal(run_path: Path, path: str) -> None:
    with h5py.File(run_path) as file:
        group = file[path]
        assert group["time"].is_scale
        assert group["time"].attrs["start"] == "2025-01-01T12:00:00+01:00"
        for name, dataset in group.items():
            if name != "time":
                assert dataset.dims[0][0] == group["time"], name


def test_the_profile_is_kept_verbatim_and_by_value(run_path: Path) -> None:
    with open_run(run_path) as run:
        assert run.text("/entry/profile/toml") == "# a comment\n[servo]\nreference = 0.80\n"
        text = run.text("/entry/profile/toml")
        assert run.text("/entry/profile/sha256") == hashlib.sha256(text.encode()).hexdigest()
        assert run.text("/entry/profile/recipe_sha256") == "ab" * 32
        assert run.text("/entry/profile/sim_sha256") == "cd" * 32
        assert run.text("/entry/profile/overrides") == "servo.reference = 0.82 (was 0.80, --set)"
        values = run.profile_values()
    assert values["servo.forward_um_s"] == 5.0
    assert values["servo.forward_um_s_units"] == "um/s"
    assert values["meta.name"] == "cu270"
    assert values["jump.on"] is True
    assert set(values) == {
        "servo.reference",
        "servo.forward_um_s",
        "servo.forward_um_s_units",
        "meta.name",
        "jump.on",
    }


def test_every_file_that_the_profile_extends_is_kept_verbatim(run_path: Path) -> None:
    with open_run(run_path) as run:
        assert run.texts("/entry/profile/parents") == ["# parent\n[servo]\nreference = 0.75\n"]
        assert run.texts("/entry/profile/parent_paths") == ["/p/base.toml"]


def test_a_profile_that_extends_nothing_has_no_parents(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", replace(meta, profile_parents=()))
    with open_run(writer.finish("done", 0)) as run:
        assert run.texts("/entry/profile/parents") == []


def test_provenance_is_complete(run_path: Path) -> None:
    with open_run(run_path) as run:
        assert run.text("/entry/command") == '["edmctl", "machine"]'
        assert run.number("/entry/seed") == 7
        assert run.number("/entry/simulated") == 1
        assert run.text("/entry/software/version") == "0.1.0"
        assert run.text("/entry/software/h5py") == h5py.version.version
        assert run.number("/entry/tool/diameter") == 270.0
        assert run.text("/entry/machine/host") == "bench"
        assert run.text("/entry/machine/toml") == "[sensor]\nnoise_um = 0.15\n"


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("forward_um_s", "um/s"),
        ("gain_um_per_v", "um/V"),
        ("depth_um", "um"),
        ("period_s", "s"),
        ("off_time_us", "us"),
        ("kp_um_s", "um/s"),
        ("hysteresis", "1"),
        ("flow_min_lpm", "L/min"),
        ("max_temp_c", "degC"),
        ("stroke_v_max", "V"),
        ("duty_min", "1"),
        ("removal_um3_per_uj", "um3/uJ"),
    ],
)
def test_a_unit_is_read_from_the_name(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_lists_become_json_and_empty_values_are_left_out() -> None:
    leaves = profile_leaves({"sites": [{"x_um": 1.0}], "nothing": None})
    assert [(leaf.key, leaf.value) for leaf in leaves] == [("sites", '[{"x_um": 1.0}]')]
