"""Compile every numba kernel once, before the tests: ``compile_kernels.py [--jobs N] [--check]``.

Compiling takes two minutes of CPU, one kernel alone 40 s; test workers that start together would each compile the same.
numba finds a kernel by the time stamp of the file that defines it: a fresh clone or a reinstalled wheel has new stamps
and compiles all again, and a change in another file that the kernel calls is not seen. So what is compiled is kept by
content: a folder of ``.cache/kernels`` a package, named by the hash of its kernel files, of Python, numba and the
processor. The stamp of each file is set from the hash of its text.

A group compiles in a process of its own, by a small call of each public function that reaches a kernel. ``--check``,
after the tests, names the kernels that these calls left to the tests.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import llvmlite
import llvmlite.binding
import numba

TESTS = Path(__file__).resolve().parent
KEPT = TESTS.parent / ".cache" / "kernels"
FIRST_STAMP, STAMPS = 946_684_800, 10**8  # [s]: 2000-01-01, and three years of seconds to choose from


def machine() -> None:
    """A machine in time: servos, friction, joints, a cut (one kernel, the longest of all)."""
    from process import Drive, FeedAxis, HalfSine, LuGre, Machine, Servo, simulate_machine, two_mass_axes

    friction = LuGre(44.2, 84.0, 6.5e-3, 168.0, 1e6, 1e3)
    axes = {"x": FeedAxis(Servo(6268.0, 10.9e-3, 45.5), friction)}
    bench = Machine(two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)}), axes)
    simulate_machine(bench, duration=0.05, feed=2e-3, forces={"x": HalfSine(5.0, 4.5e-3, 0.0)}, sample_rate=1e3)


def cuts() -> None:
    """Milling in time, given forces on modes, and the stability methods, with equal and with unequal pitch."""
    import math

    import numpy as np

    from process import (
        CuttingCoefficients,
        MillingCut,
        ModalModel,
        Spindle,
        Tool,
        engagement,
        simulate_forced,
        simulate_milling,
    )
    from stability import (
        critical_depth,
        floquet_multipliers,
        limit_depth,
        multi_frequency,
        semi_discretization,
        zero_order,
    )

    bench = ModalModel([61.4, 80.0], [0.02, 0.02], [1.68e6, 2e6], [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    material = CuttingCoefficients(780e6, 351e6, 0.0)
    simulate_forced(bench, np.zeros((3, 100)), 5000.0)
    compliance = bench.compliance(np.arange(20.0, 200.0, 0.5))
    # Few unknowns are solved as dense matrices, many by Krylov vectors.
    few, many = Tool(0.0508, 4), Tool(0.0508, 30, pitch_angles=tuple(np.radians([11.0, 13.0] * 15)))
    narrow, slot = engagement("down", 0.01, 0.0508), engagement("up", 0.0508, 0.0508)
    simulate_milling(bench, MillingCut(few, slot, material, 1e-3, feed_per_tooth=1e-4), Spindle(100.0), 0.1, 5000.0)
    critical_depth(compliance, few, slot, material)
    for tool, arc in ((few, narrow), (many, slot)):
        zero_order(compliance, tool, arc, material, [900.0, 1500.0])
        limit_depth(bench, tool, arc, material, 60.0 * 60.0 / tool.teeth * math.sqrt(2.0))
        floquet_multipliers(bench, tool, arc, material, 1e-3, 900.0)
        semi_discretization(bench, tool, arc, material, 60.0 * 60.0 / tool.teeth * np.array([1.4, 1.42]))
    for arc in (narrow, slot):
        multi_frequency(bench, few, arc, material, [900.0, 905.0])


def friction() -> None:
    """Friction laws, joints, and harmonic balance with one and many harmonics."""
    import numpy as np

    from process import (
        Andersson,
        Drive,
        FeedAxis,
        Gap,
        Jenkins,
        LuGre,
        Machine,
        MountedJoint,
        Servo,
        equivalent_damping,
        quasi_compliance,
        two_mass_axes,
    )

    v = np.linspace(-1e-2, 1e-2, 64)
    law, memory = Andersson(44.2, 84.0, 6.5e-3, 168.0, 15000.0), LuGre(44.2, 84.0, 6.5e-3, 168.0, 1e6, 1e3)
    law.force(v)
    law.slope(v)
    equivalent_damping(law, 2e-3, np.array([1e-3, 4e-3]))
    memory.history(v, 1e-4)
    Jenkins(1e6, 30.0).force(1e-2 * v)
    structure = two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)})
    axes = {"x": FeedAxis(Servo(6268.0, 10.9e-3, 45.5), law)}
    play = [MountedJoint(Gap(1e5, 1e-5), [1.0, 0.0])]
    frequency = np.linspace(55.0, 70.0, 6)
    for joints, tolerance in (([], np.inf), ([], 1e-6), (play, 1e-6)):
        quasi_compliance(Machine(structure, axes, joints), frequency, 50.0, 2e-3, excitation=["x"], tolerance=tolerance)


def tuning() -> None:
    """Loops of many gains, for one axis and for several."""
    import numpy as np

    from process import Drive, Machine, two_mass_axes
    from smfe.tuning.depths import Oriented
    from smfe.tuning.loops import close
    from smfe.tuning.plants import ModelSource

    point = Machine(two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)})).at()
    plant = ModelSource(point, ("x",), (1e-3,)).plant(np.geomspace(1.0, 500.0, 20))
    close(plant, Oriented.of(np.eye(3), plant.directions), np.array([[[6e3, 1e-2, 40.0]]]))


def axis_oracle() -> None:
    """The independent simulator of an axis."""
    import numpy as np
    from truth.axis import Setting, Truth, simulate

    simulate(Truth(), Setting(5e-3, "K2"), np.array([[0.01, 50.0, 1.7e-3, 3.0]]), np.zeros((0, 5)), 0.05)


def other_oracles() -> None:
    """The independent simulators of drives, sweeps, cuts and an oscillator."""
    from dataclasses import replace

    import numpy as np
    from truth import drive, milling_limits, milling_map, oscillator, sweep
    from truth.imperfect import drive as moving
    from truth.imperfect import modal

    drive.simulate(drive.Axis(), 1)
    sweep.measure(sweep.required(1, 1, seconds=2.0), 1, ("down",))
    one = {"mass": 1.0, "stiffness": 1e4, "damping": 1.0, "cubic_damping": 0.0, "cubic_stiffness": 0.0, "friction": 0.0}
    oscillator.hit(10.0, 1e-3, 0.1, 1e-3, **one)
    mill = milling_limits.Mill()
    milling_limits.growth(mill, 3000.0, 1e-4)
    modes = np.array([800.0]), np.array([0.02]), np.array([2e7]), np.array([[1.0, 0.0, 0.0]])
    cut = milling_map.MillingCut(*modes, np.radians([180.0, 180.0]), ((0.0, 1.0),), (8e8, 3e8, 0.0))
    milling_map.TurnMap(cut, 3000.0).multipliers(1e-4)
    joint = modal.drawn_shop(np.random.default_rng(1)).machine
    modal.in_time(replace(joint, loose=0.1), modal.State(), np.zeros((joint.ram.mass.shape[0], 16)), 1e4)
    rail = moving.drawn(np.random.default_rng(1))
    moving.simulated(replace(rail, target=np.concatenate([np.zeros(8), rail.target[:9000]])))


GROUPS = {
    "machine": (machine, ("process",)),
    "friction": (friction, ("process",)),
    "cuts": (cuts, ("process", "stability")),
    "tuning": (tuning, ("smfe",)),
    "axis_oracle": (axis_oracle, ("truth",)),
    "other_oracles": (other_oracles, ("truth",)),
}
"""What is compiled together, the longest first, and the packages whose kernels it calls."""

PACKAGES = sorted({package for _, needed in GROUPS.values() for package in needed})


def folder_of(package: str) -> Path:
    """Return the folder of an installed package, which is not imported."""
    if package == "truth":
        return TESTS / "truth"
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        sys.exit(f"{package} is not installed; make does that")
    return Path(spec.origin).parent


def kernel_files(package: str) -> list[Path]:
    """Return the files of a package that compile something, and set their stamps by their content."""
    found = [
        f for f in sorted(folder_of(package).rglob("*.py")) if "njit" in (text := f.read_text("utf-8")) and "@" in text
    ]
    for file in found:
        stamp = FIRST_STAMP + int(hashlib.sha256(file.read_bytes()).hexdigest(), 16) % STAMPS
        os.utime(file, (stamp, stamp))
    return found


def compiled(package: str) -> list[Path]:
    """Return numba's files of a package."""
    return sorted(f for f in folder_of(package).rglob("*.nb[ic]"))


def key(package: str) -> str:
    """Return what the compiled kernels of a package depend on, as a hash."""
    root = folder_of(package)
    parts = [platform.python_version(), numba.__version__, llvmlite.__version__, llvmlite.binding.get_host_cpu_name()]
    parts += [f"{f.relative_to(root)} {f.read_text('utf-8')}" for f in kernel_files(package)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def restore(package: str) -> bool:
    """Put the kernels of this content in place, and take all others away; False where none are kept."""
    root, kept = folder_of(package), KEPT / package / key(package)
    for file in compiled(package):
        file.unlink()
    for file in kept.rglob("*.nb[ic]"):
        target = root / file.relative_to(kept)
        target.parent.mkdir(exist_ok=True)
        shutil.copy2(file, target)
    return kept.exists()


def keep(package: str) -> None:
    """Keep the kernels of this content; what is there stays."""
    root, kept = folder_of(package), KEPT / package / key(package)
    for file in compiled(package):
        target = kept / file.relative_to(root)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(file, target)


def compile_group(name: str) -> subprocess.CompletedProcess[str]:
    """Compile a group in a process of its own."""
    return subprocess.run([sys.executable, __file__, "--group", name], capture_output=True, text=True, check=False)


def check() -> None:
    """Say what the tests had to compile."""
    for package in PACKAGES:
        root, kept = folder_of(package), KEPT / package / key(package)
        new = [f for f in compiled(package) if f.suffix == ".nbc" and not (kept / f.relative_to(root)).exists()]
        print(f"{package}: the tests compiled {', '.join(f.name for f in new) or 'nothing'}")


def main() -> None:
    """Compile what is not kept."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    parser.add_argument("--check", action="store_true", help="say what the tests had to compile")
    parser.add_argument("--group", choices=GROUPS, help="compile this group alone, in this process")
    asked = parser.parse_args()
    if asked.group:
        return GROUPS[asked.group][0]()
    if asked.check:
        return check()
    missing = {p for p in PACKAGES if not restore(p)}
    todo = [name for name, (_, needed) in GROUPS.items() if missing.intersection(needed)]
    start = time.perf_counter()
    with ThreadPoolExecutor(asked.jobs) as pool:
        for name, result in zip(todo, pool.map(compile_group, todo), strict=True):
            if result.returncode:
                sys.exit(f"{name}: {result.stderr}")
    for package in missing:
        keep(package)
    if todo:
        print(f"kernels compiled ({', '.join(todo)}): {time.perf_counter() - start:.0f} s")
    return None


if __name__ == "__main__":
    main()
