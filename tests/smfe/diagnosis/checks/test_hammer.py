"""Claims: hits of very different level are noted."""

import numpy as np

from process.instruments.trials import Sensors, hammer_trial
from process.machine.modes import ModalModel
from smfe.diagnosis.checks.hammer import hit_suspects
from smfe.identification.hammer.hammer import identify_hammer

MACHINE = ModalModel(
    [24.0, 34.0, 58.0, 95.0],
    [0.022, 0.03, 0.03, 0.04],
    [4e7, 5e7, 6e7, 5e7],
    [[0.3, 0.9, 0.1], [0.9, 0.2, 0.1], [0.4, 0.6, 0.7], [0.8, -0.5, 0.3]],
)


def test_hits_of_very_different_level_are_noted() -> None:
    sensors = Sensors((1.0, 1.0, 1.0), (0.01, 0.01, 0.01))
    for levels, causes in (((1.0, 1.0, 6.0), {"joint_micro_slip"}), ((1.0, 1.1, 0.9), set())):
        records = {"x": [hammer_trial(MACHINE, "x", levels, sensors, np.random.default_rng(5))]}
        found = {s.cause for s in hit_suspects("hammer", records, identify_hammer("hammer", records))}
        assert causes <= found
        assert bool(found) == bool(causes)
