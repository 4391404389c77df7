"""Claims: skew, broken reciprocity and factors of units are named, and a good machine gives nothing."""

import numpy as np
import pytest
import xarray as xr

from process.labels import make_compliance
from process.machine.modes import ModalModel
from smfe.campaign import Model
from smfe.diagnosis.audit import rightly_named
from smfe.diagnosis.checks.compliances import (
    factor_suspects,
    model_suspects,
    mounting_suspects,
    reciprocity_suspects,
    skew_suspects,
)
from smfe.identification.measurement import sign_warnings

MACHINE = ModalModel(
    [24.0, 34.0, 58.0, 95.0],
    [0.022, 0.03, 0.03, 0.04],
    [4e7, 5e7, 6e7, 5e7],
    [[0.3, 0.9, 0.1], [0.9, 0.2, 0.1], [0.4, 0.6, 0.7], [0.8, -0.5, 0.3]],
)


F = np.arange(10.0, 200.0, 0.25)


def causes(suspects) -> set[str]:  # type: ignore[no-untyped-def]
    return {s.cause for s in suspects}


def compliance(matrix: np.ndarray, noise: float = 0.0, seed: int = 0) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    std = noise * np.abs(matrix)
    error = std / np.sqrt(2.0) * (rng.standard_normal(matrix.shape) + 1j * rng.standard_normal(matrix.shape))
    dims = ("frequency", "response", "excitation")
    return make_compliance(F, matrix + error, extra={"compliance_std": (dims, std)})


class TestCompliances:
    def test_a_good_machine_is_not_suspicious(self) -> None:
        good = compliance(MACHINE.matrix(F), 0.01)
        assert not list(skew_suspects("m", good))
        assert not list(reciprocity_suspects("m", good))
        assert not list(factor_suspects({"a": good, "b": compliance(MACHINE.matrix(F), 0.01, 1)}))

    @pytest.mark.parametrize("skew", [500e-6, 200e-6, 100e-6, -500e-6])
    def test_a_time_skew_is_found_with_its_sign_and_a_lower_bound(self, skew: float) -> None:
        late = MACHINE.matrix(F) * np.exp(-2j * np.pi * F * skew)[:, None, None]
        found = list(skew_suspects("m", compliance(late, 0.005)))
        assert len(found) >= 1
        assert ("late" if skew > 0 else "early") in found[0].evidence
        size = float(found[0].evidence.split(" us or more")[0].split()[-1])
        # What damping hides cannot be seen: the shift is the least that makes the machine passive.
        assert 0.15 * abs(skew) * 1e6 < size < 1.05 * abs(skew) * 1e6

    def test_an_accelerometer_on_the_wrong_axis_breaks_reciprocity(self) -> None:
        mixed = MACHINE.matrix(F).copy()
        mixed[:, 0, :] = mixed[:, 0, :] * 0.4
        assert causes(reciprocity_suspects("m", compliance(mixed, 0.01))) == {"sensor_axis"}

    @pytest.mark.parametrize("seed", range(6))
    def test_what_leaning_hits_and_turned_sensors_do_is_no_fault(self, seed: int) -> None:
        """Two degrees and one per cent of cross-talk put a tenth of the direct entries into weak cross terms."""
        rng = np.random.default_rng(seed)
        weak = MACHINE.matrix(F) * np.where(np.eye(3), 1.0, 0.15)
        hits, sensors = (np.eye(3) + 0.025 * rng.standard_normal((3, 3)) for _ in range(2))
        tilted = compliance(sensors @ weak @ hits, 0.005, seed)
        assert not list(reciprocity_suspects("m", tilted))
        assert not list(mounting_suspects("m", tilted))

    @pytest.mark.parametrize(("factor", "entries"), [(4.34, ((1, 2),)), (-4.45, ((0, 2), (1, 2)))])
    def test_a_factor_that_no_channel_makes_is_no_unit(self, factor: float, entries: tuple) -> None:
        """One weak entry may be off by any factor; a unit is in all of a column or row, and turns no sign."""
        mixed = MACHINE.matrix(F).copy()
        for row, column in entries:
            mixed[:, row, column] *= factor
        assert not [s for s in reciprocity_suspects("m", compliance(mixed, 0.005)) if s.cause == "unit_error"]

    def test_integrated_noise_below_the_modes_turns_no_sign(self) -> None:
        """An acceleration integrated twice is mostly noise at the lowest lines, and largest there."""
        noisy = MACHINE.matrix(F).copy()
        noisy[F < 10.8] = 2.0j * np.abs(noisy).max() * np.eye(3)
        # Above the modes the phase is that of noise, on more than half of the lines.
        noisy[F > 102.0] += 0.2j * np.abs(noisy[F > 102.0])
        found = compliance(noisy, 1e-3)
        assert not list(mounting_suspects("m", found))
        assert not sign_warnings(found)
        turned = compliance(-MACHINE.matrix(F), 1e-3)
        assert len(sign_warnings(turned)) == 3
        assert list(mounting_suspects("m", turned))

    def test_a_column_in_kilonewtons_is_named_beside_leaning_hits(self) -> None:
        rng = np.random.default_rng(3)
        mixed = MACHINE.matrix(F) @ (np.eye(3) + 0.02 * rng.standard_normal((3, 3)))
        mixed[:, :, 1] *= 1e3
        found = list(reciprocity_suspects("m", compliance(mixed, 0.005)))
        assert {s.where for s in found if s.cause == "unit_error"} == {"m, xy and yx", "m, yz and zy"}

    @pytest.mark.parametrize(
        ("matrix", "cause", "said"),
        [
            (np.eye(3)[[1, 0, 2]], "sensor_axis", "exchange the columns of acceleration_x and acceleration_y"),
            (np.eye(3)[[0, 2, 1]], "sensor_axis", "exchange the columns of acceleration_y and acceleration_z"),
            (np.diag([1, -1, 1]), "sensor_gain", "declare sign = -1 on acceleration_y"),
            (-np.eye(3), "sensor_gain", "declare sign = -1 on the force channels"),
            (np.diag([-1, 1, 1]) @ np.eye(3)[[0, 2, 1]], "sensor_axis", "acceleration_y and acceleration_z"),
        ],
    )
    def test_the_advice_fits_the_channels(self, matrix: np.ndarray, cause: str, said: str) -> None:
        """Exchanged axes are not mended by a sign, nor a sign by an exchange."""
        (found,) = mounting_suspects("m", compliance(matrix @ MACHINE.matrix(F), 0.01))
        assert (found.cause, found.level) == (cause, "fault")
        assert said in found.advice
        assert ("sign = -1" in found.advice) == bool((matrix < 0).any())
        assert ("exchange the columns" in found.advice) == (cause == "sensor_axis")

    def test_the_unit_of_exchanged_channels_is_not_accused_for_what_a_cross_term_is_of_a_driving_point(self) -> None:
        """A tenth, which is about one over the acceleration of gravity: the measurement would be left out for it."""
        near = ModalModel([34.0, 58.0, 90.0], [0.03] * 3, [5e7] * 3, [[1.0, 0.1, 0.0], [-0.1, 1.0, 0.0], [0.1, 0, 1.0]])
        right, wrong = (compliance(m @ near.matrix(F), 0.01) for m in (np.eye(3), np.eye(3)[[1, 0, 2]]))
        models = [Model("declared", near)]
        assert causes(model_suspects({"m": wrong}, models)) == {"unit_error"}
        known = rightly_named({"m": wrong, "good": right}, list(mounting_suspects("m", wrong)))
        assert list(known) == ["good"]
        assert not list(model_suspects(known, models))

    @pytest.mark.parametrize(("factor", "cause"), [(1e3, "unit_error"), (9.80665, "unit_error"), (1.5, "sensor_gain")])
    def test_a_constant_factor_is_no_physics(self, factor: float, cause: str) -> None:
        one, two = compliance(MACHINE.matrix(F), 0.01), compliance(factor * MACHINE.matrix(F), 0.01, 1)
        found = list(factor_suspects({"a": one, "b": two}))
        assert causes(found) == {cause}
        assert all(s.level == "fault" for s in found)

    @pytest.mark.parametrize(("degrees", "accused"), [(180.0, True), (5.0, True), (-77.0, False)])
    def test_no_gain_turns_a_phase_by_seventy_degrees(self, degrees: float, accused: bool) -> None:
        turned = 1.5 * np.exp(1j * np.radians(degrees)) * MACHINE.matrix(F)
        pair = {"a": compliance(MACHINE.matrix(F), 0.01), "b": compliance(turned, 0.01, 1)}
        assert bool(list(factor_suspects(pair))) == accused

    def test_a_softer_machine_is_not_a_factor(self) -> None:
        softer = ModalModel(MACHINE.frequency * 0.94, MACHINE.damping * 1.2, MACHINE.stiffness * 0.8, MACHINE.direction)
        pair = {"idle": compliance(MACHINE.matrix(F), 0.01), "moving": compliance(softer.matrix(F), 0.01, 1)}
        assert not list(factor_suspects(pair))
