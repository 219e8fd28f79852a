"""Depth to target by measured cuts."""

from __future__ import annotations

import random
import statistics

import pytest

from edmctl.process.next_cut import first_feed_um, next_cut


def test_the_first_cut_stays_short_by_its_fraction() -> None:
    assert first_feed_um(180.0, 0.389, 0.85) == pytest.approx(0.85 * 180.0 * 1.389)


def test_a_rest_within_half_the_tolerance_ends_the_job() -> None:
    end = next_cut(target_um=180.0, depth_um=179.1, wear_ratio=0.39, tolerance_um=2.0, depth_noise_um=0.1)
    assert end.done
    assert end.remaining_um == pytest.approx(0.9)


def test_a_short_rest_is_cut_whole_with_its_wear() -> None:
    cut = next_cut(target_um=180.0, depth_um=170.0, wear_ratio=0.4, tolerance_um=2.0, depth_noise_um=0.1)
    assert cut.feed_um == pytest.approx(14.0)


def test_a_long_rest_is_cut_short_once_more() -> None:
    cut = next_cut(target_um=180.0, depth_um=150.0, wear_ratio=0.4, tolerance_um=2.0, depth_noise_um=0.1)
    assert cut.feed_um == pytest.approx(0.9 * 30.0 * 1.4)


def test_a_rest_within_the_noise_is_not_chased() -> None:
    assert next_cut(
        target_um=180.0, depth_um=178.5, wear_ratio=0.4, tolerance_um=2.0, depth_noise_um=0.8
    ).done


def test_too_deep_a_hole_ends_the_job() -> None:
    assert next_cut(
        target_um=180.0, depth_um=181.0, wear_ratio=0.4, tolerance_um=2.0, depth_noise_um=0.1
    ).done


def test_with_touches_of_half_a_micrometre_the_depth_is_within_two_in_95_percent() -> None:
    rng = random.Random(3)
    z_sd, errors = 0.5, []
    noise = z_sd * (2 / 3) ** 0.5
    for _ in range(1000):
        true_ratio = 0.389 * rng.gauss(1.0, 0.10)
        feed = first_feed_um(180.0, 0.389, 0.85)
        depth = wear = 0.0
        for _cut in range(5):
            step = feed / (1.0 + true_ratio * rng.gauss(1.0, 0.05))
            depth, wear = depth + step, wear + feed - step
            measured = depth + rng.gauss(0.0, noise)
            cut = next_cut(
                target_um=180.0,
                depth_um=measured,
                wear_ratio=wear / measured,
                tolerance_um=2.0,
                depth_noise_um=noise,
            )
            if cut.done:
                break
            feed = cut.feed_um
        errors.append(depth - 180.0)
    assert sum(abs(e) <= 2.0 for e in errors) >= 950
    assert abs(statistics.fmean(errors)) < 0.5
