"""Where procedures put what they see: a run file, or nowhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.record.rows import EventLevel, LinkRow, ServoBlock, SiteRow, SlowRow, TouchRow, TruthMap
    from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch


class Recorder(Protocol):
    """Takes rows in order of time. Any call may raise RunFileError once, when the disk fails; later rows are
    then ignored, so that the caller can still bring the machine to its safe point.
    """

    def append_servo(self, block: ServoBlock) -> None: ...

    def append_slow(self, row: SlowRow) -> None: ...

    def append_pulse_blocks(self, blocks: PulseBlockBatch) -> None: ...

    def append_pulses(self, train: PulseTrain) -> None: ...

    def event(
        self,
        time_s: float,
        code: int,
        level: EventLevel,
        message: str,
        args: Mapping[str, float | int | str | bool] | None = None,
    ) -> None: ...

    def touch(self, row: TouchRow) -> None: ...

    def reject_touch(self, time_s: float) -> None: ...

    def site_result(self, row: SiteRow) -> None: ...

    def black_box(self, block: TelemetryBlock) -> None: ...

    def waveforms(self, block: WaveformBatch) -> None: ...

    def append_link(self, row: LinkRow) -> None: ...

    def truth_map(self, truth: TruthMap) -> None: ...

    def summary(self, json_text: str) -> None: ...


class NullRecorder:
    """Forgets everything: for runs without a file."""

    def append_servo(self, block: ServoBlock) -> None:
        """Forget."""

    def append_slow(self, row: SlowRow) -> None:
        """Forget."""

    def append_pulse_blocks(self, blocks: PulseBlockBatch) -> None:
        """Forget."""

    def append_pulses(self, train: PulseTrain) -> None:
        """Forget."""

    def event(
        self,
        time_s: float,
        code: int,
        level: EventLevel,
        message: str,
        args: Mapping[str, float | int | str | bool] | None = None,
    ) -> None:
        """Forget."""

    def touch(self, row: TouchRow) -> None:
        """Forget."""

    def reject_touch(self, time_s: float) -> None:
        """Forget."""

    def site_result(self, row: SiteRow) -> None:
        """Forget."""

    def black_box(self, block: TelemetryBlock) -> None:
        """Forget."""

    def waveforms(self, block: WaveformBatch) -> None:
        """Forget."""

    def append_link(self, row: LinkRow) -> None:
        """Forget."""

    def truth_map(self, truth: TruthMap) -> None:
        """Forget."""

    def summary(self, json_text: str) -> None:
        """Forget."""
