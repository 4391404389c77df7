"""What a scenario is made of, each for itself: jobs in parallel, the truth of a sampled servo."""

import numpy as np
import pytest

from process.drive.servo import tune
from process.errors import InputError
from process.friction.laws import Viscous
from process.instruments.trials import Running
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import released_modes
from process.simulation.excitation import HalfSine
from process.simulation.machine import simulate_machine
from process.simulation.problem import SampledControl
from smfe.scenario import run
from smfe.scenario.run import run_all


def test_results_come_in_the_order_of_the_jobs_and_progress_counts_them() -> None:
    seen: list[tuple[str, int, int]] = []
    found = run_all(lambda n: n * n, range(20), workers=4, progress=lambda *at: seen.append(at))
    assert found == [n * n for n in range(20)]
    assert [(done, of) for _, done, of in seen] == [(n, 20) for n in range(21)]
    assert sorted(what for what, *_ in seen) == sorted(["simulating", *map(str, range(20))])
    with pytest.raises(InputError, match="0 workers"):
        run_all(lambda n: n, [1], workers=0)


@pytest.mark.parametrize(("resolution", "order_off"), [(0.0, 0.005), (1e-9, 0.02)])
def test_the_truth_of_a_sampled_servo_is_what_it_does(resolution: float, order_off: float) -> None:
    # At a period of a tenth of Ti; with the gains as they stand the truth would be off by 3 and 12 %.
    modes = ModalModel([40.0, 63.0], [0.03, 0.04], [2e7, 3e7], [[0.8, 0.1, 0.6], [-0.5, 0.3, 0.7]])
    servo = {"K": tune(20.0, 1500.0)}
    axis = FeedAxis(servo, Viscous(2000.0))
    machine = Machine(released_modes(modes, {"x": 1500.0}, tip_mass=100.0), {"x": axis})
    control = SampledControl(2e-3, 1, resolution)
    record = simulate_machine(
        machine, duration=8.0, forces={"x": HalfSine(3.0)}, controller="K", control=control, sample_rate=2000.0
    )
    f = np.fft.rfftfreq(record.sizes["time"], 1.0 / 2000.0)
    band = (f > 3.0) & (f < 90.0)
    force, moved = (np.fft.rfft(record[name].sel(axis="x").values)[band] for name in ("force", "displacement"))
    true = run._true(machine, Running(0.0, "K", None, control), f[band])["compliance"].values[:, 0, 0]
    assert np.abs(true - moved / force).max() < order_off * np.abs(true).max()
