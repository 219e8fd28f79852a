"""What every run file holds."""

from __future__ import annotations

import hashlib
from dataclasses import fields, replace
from pathlib import Path

import h5py
import pytest

from edmctl.record import layout, rows
from edmctl.record.reader import open_run
from edmctl.record.rows import EventRow, RunMeta, profile_leaves, unit_of
from edmctl.results.telemetry import PulseBlockBatch
from tests.record.samples import finished

TOML = "# a comment\n[servo]\nreference = 0.80\n"


def test_every_described_path_exists_and_nothing_else_does(run_path: Path) -> None:
    described = {group.path for group in layout.GROUPS} | {scalar.path for scalar in layout.SCALARS}
    described |= {table.path for table in layout.TABLES} | {layout.TRUTH.path}
    described |= {path for table in layout.TABLES for path in table.datasets}
    described |= set(layout.TRUTH.datasets)
    plotted = (layout.DEFAULT_AXIS, layout.DEFAULT_SIGNAL, *layout.DEFAULT_AUXILIARY)
    described |= {f"{layout.DEFAULT_PLOT}/{name}" for name in plotted}
    found: set[str] = set()
    with h5py.File(run_path) as file:
        file.id.links.visit(lambda path: found.add("/" + path.decode()))
    assert found == described


def test_every_dataset_has_a_unit_and_a_name_and_no_text_in_the_global_heap(run_path: Path) -> None:
    datasets: dict[str, h5py.Dataset] = {}

    def visit(path: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset):
            datasets[path] = item

    with h5py.File(run_path) as file:
        file.visititems(visit)
        assert [path for path, one in datasets.items() if not {"units", "long_name"} <= set(one.attrs)] == []
        assert [path for path, one in datasets.items() if one.dtype.hasobject] == []
        assert file["/entry/servo/z_sensor"].attrs["units"] == "um"
        assert len(file["/entry/touches"].attrs["units"]) == len(file["/entry/touches"].dtype.names)
        kind = h5py.check_string_dtype(file["/entry/profile/toml"].dtype)
    assert (kind.encoding, kind.length) == ("utf-8", len(TOML))


def test_texts_beyond_ascii_are_read_as_they_were_written(tmp_path: Path, meta: RunMeta) -> None:
    event = EventRow(1.0, 100, rows.EventLevel.INFO, "55 µm → 60 µm")
    path = finished(tmp_path / "run.h5", event, meta=replace(meta, title="Größe Ø 270 µm", user=""))
    with open_run(path) as run:
        assert [run.text(f"/entry/{name}") for name in ("title", "user/name")] == ["Größe Ø 270 µm", ""]
    with h5py.File(path) as file:
        assert file["/entry/title"].asstr()[()] == "Größe Ø 270 µm"
        assert h5py.check_string_dtype(file["/entry/events"].dtype["message"]).encoding == "utf-8"
        assert file["/entry/events"][0]["message"].decode() == "55 µm → 60 µm"


@pytest.mark.parametrize("table", [table for table in layout.TABLES if table.nx_class == "NXdata"])
def test_a_group_of_columns_says_what_viewers_plot(run_path: Path, table: layout.Table) -> None:
    units = {column.name: column.units for column in table.columns}
    with h5py.File(run_path) as file:
        group = file[table.path]
        assert group.attrs["signal"] == table.signal
        assert list(group.attrs.get("axes", [])) == (["time"] if "time" in units else [])
        assert {units[name] for name in group.attrs.get("auxiliary_signals", [])} <= {units[table.signal]}
        if "time" in units:
            assert group["time"].is_scale
            assert group["time"].attrs["start"] == "2025-01-01T12:00:00+01:00"
            assert all(group[name].dims[0][0] == group["time"] for name in units if name != "time")


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
    assert sorted(column.field for column in table.columns) == sorted(field.name for field in fields(row))


def test_the_default_plot_is_found_from_the_root(run_path: Path) -> None:
    with h5py.File(run_path) as file:
        entry = file[file.attrs["default"]]
        plot = entry[entry.attrs["default"]]
        assert plot.attrs["NX_class"] == "NXdata"
        names = [plot.attrs["signal"], *plot.attrs["axes"], *plot.attrs["auxiliary_signals"]]
        assert names == ["z_sensor", "time", "z_model"]
        assert all(plot[name] == file[f"/entry/servo/{name}"] for name in names)


def test_profile_and_provenance_are_complete(run_path: Path, tmp_path: Path, meta: RunMeta) -> None:
    texts = {
        "profile/toml": TOML,
        "profile/sha256": hashlib.sha256(TOML.encode()).hexdigest(),
        "profile/recipe_sha256": "ab" * 32,
        "profile/sim_sha256": "cd" * 32,
        "profile/overrides": "servo.reference = 0.82 (was 0.80, --set)",
        "command": '["edmctl", "machine"]',
        "software/version": "0.1.0",
        "software/h5py": h5py.version.version,
        "machine/host": "bench",
        "machine/toml": "[sensor]\nnoise_um = 0.15\n",
    }
    with open_run(run_path) as run:
        assert {name: run.text(f"/entry/{name}") for name in texts} == texts
        assert [run.number(f"/entry/{name}") for name in ("seed", "simulated")] == [7, 1]
        assert run.number("/entry/tool/diameter") == 270.0
        assert run.profile_values() == {
            "servo.reference": 0.8,
            "servo.forward_um_s": 5.0,
            "servo.forward_um_s_units": "um/s",
            "meta.name": "cu270",
            "jump.on": True,
        }
        assert run.profile_values()["jump.on"] is True
    with (
        h5py.File(run_path) as file,
        h5py.File(finished(tmp_path / "alone.h5", meta=replace(meta, profile_parents=()))) as alone,
    ):
        parents, paths = (file[f"/entry/profile/{name}"].asstr()[:] for name in ("parents", "parent_paths"))
        assert (list(parents), list(paths)) == (["# parent\n[servo]\nreference = 0.75\n"], ["/p/base.toml"])
        assert not len(alone["/entry/profile/parents"])


def test_a_unit_is_read_from_the_name() -> None:
    units = {
        **{
            "forward_um_s": "um/s",
            "gain_um_per_v": "um/V",
            "depth_um": "um",
            "period_s": "s",
            "off_time_us": "us",
        },
        **{
            "kp_um_s": "um/s",
            "hysteresis": "1",
            "flow_min_lpm": "L/min",
            "max_temp_c": "degC",
            "duty_min": "1",
        },
        **{"stroke_v_max": "V", "removal_um3_per_uj": "um3/uJ"},
    }
    assert {name: unit_of(name) for name in units} == units


def test_lists_become_json_and_empty_values_are_left_out() -> None:
    leaves = profile_leaves({"sites": [{"x_um": 1.0}], "nothing": None})
    assert leaves == {"sites": '[{"x_um": 1.0}]'}
