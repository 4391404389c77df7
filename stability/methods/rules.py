"""The chosen numbers of the stability methods; those of compiled loops stand beside them in `_*_kernels.py`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MethodRules:
    """Settings, each with its reason; by the module that uses it."""

    # floquet_crossings.py
    negligible_eigenvalue: float = 3e-3
    """Eigenvalues below this share of the largest over all angles stand for depths beyond any limit of use."""
    largest_step: float = 0.25
    """An eigenvalue near the real axis may change by this share of itself before the interval is halved."""
    tangent_step: float = 0.02
    """As `largest_step` where a curve comes near the axis without crossing it: a narrow island hides there."""
    close_to_end: float = 2e-4
    """Distance from theta = 0 and pi up to which curves are sampled [rad]; nearer they have become a fold or a flip."""
    pieces_a_pitch: float = 12.0
    """Pieces in which the depth of a helix pitch is searched for crossings."""
    beyond_straight: float = 1.15
    """Depth at which the first of these pieces ends at the latest, over the limit of straight edges."""
    pieces_of_depth: float = 48.0
    """The same of any depth, where these pieces are longer: the harmonics then are small beside the mean."""
    largest_turn: float = 1.6
    """Largest change of the phase of a determinant in a step [rad]."""
    share_of_bound: float = 0.7
    """Eigenvalues below this share of 1/depth of a crossing that is known are not looked at between two angles."""
    smallest_interval: float = 1e-7
    """Intervals of theta are not halved below this [rad]."""

    # multi_frequency.py
    most_harmonics: int = 64
    """Harmonics are not added beyond this; up to four times as many where short arcs keep the unknowns few."""
    even_steps: int = 48
    """Even steps in which the whole range of w is scanned; about resonances the scan is finer."""
    steps_a_line: float = 4.0
    """Steps of a scan to a line of a measured compliance, the finest of those that pass by: two overlooked a crossing
    in 150 speeds of noisy records, three none."""
    checked_steps: float = 0.5
    """Share of these steps with which the stability below a limit is checked."""
    matrices_at_once: int = 256
    """Of a scan."""
    scans_of_a_record: int = 6
    """Scans for a crossing below the one that has settled, at the most."""
    confirmed_shares_of_harmonics: tuple[float, ...] = (0.5, 0.75, 0.9, 0.98)
    """Shares of a limit at which the cut must be stable."""
    tracked_shares_of_harmonics: tuple[float, ...] = (0.7, 0.98)
    """The same of a limit that was followed from a neighbouring speed."""
    crossings_below: int = 4
    """Crossings below one another that are tried before all are searched for."""
    largest_change: float = 0.2
    """Relative change by more harmonics beyond which a limit that was followed is searched for instead."""
    most_unknowns: int = 128
    """Unknowns up to which harmonics beyond `most_harmonics` are added."""
    nodes_a_radian: float = 0.6
    """Gauss nodes on an arc for each radian that the last harmonic turns there; 0.5 is the least that resolves it."""
    spare_nodes: int = 8
    """Gauss nodes on an arc beyond those."""

    # period_mesh.py
    fewest_nodes: int = 4
    """Smallest number of nodes in an element."""
    highest_order: int = 24
    """Largest number of nodes in an element."""
    wasted_nodes: float = 1.3
    """Largest factor by which the nodes over a period exceed the fewest for the sake of more nodes in an element."""

    # semi_discretization.py
    confirmed_shares: tuple[float, ...] = (0.3, 0.6, 0.8, 0.9, 0.97, 0.999)
    """Shares of a limit at which the map over one period must be stable."""
    tracked_shares: tuple[float, ...] = (0.3, 0.5, 0.6, 0.7, 0.76, 0.82, 0.88, 0.94, 0.98, 0.999)
    """The same of a limit that was followed from a neighbouring speed: where it is unstable, a crossing lies below."""
    beyond_tracked: float = 1.5
    """Times the limit at a neighbouring speed up to which one is looked for where that has gone, time and again."""
    beyond_steps: int = 6
    """So often: ten times as deep."""
    finer_tracked: float = 1.3
    """As `finer` where a limit is followed: the error falls faster than any power of the steps."""
    needless: float = 0.02
    """Share of the tolerance below which a change shows that the next speed may begin with fewer steps."""
    dense: int = 160
    """Unknowns up to which a cut is solved as dense matrices."""
    halvings: int = 24
    """Of an interval of depth in which something begins to grow, at the most."""
    rungs: float = 4.0
    """Meshes in which the steps double."""
    full_search: int = 48
    """Up to this size all eigenvalues are taken; above, Arnoldi's method goes on until the large ones stand still."""
    large_eigenvalue: float = 0.2
    """Where not all eigenvalues are taken, those above this share of the largest are; fewer when that fails."""
    finer: float = 1.7
    """Least factor from the steps of a mesh to those of the next: the error falls by far more than that."""
    most_steps: int = 4096
    """No finer mesh is tried beyond."""

    # stationary_vibration.py
    first_steps_of_vibration: int = 16
    """Steps of the coarsest mesh, beyond those that resolve the fastest mode."""
    most_steps_of_vibration: int = 2048
    """Doubling stops here."""
    chips_of_vibration: int = 60
    """Vectors that chips of a periodic vibration are looked for in, at most; beyond, all of them are solved for."""
    residual_of_chips: float = 1e-8
    """Of the chips: above it those vectors do not suffice."""

    # vibration_mode.py
    reach_of_samples: float = 30.0
    """A machine is sampled from this share below its lowest pole to this multiple of its highest."""
    density_of_samples: float = 16.0
    """Samples a doubling of the distance from a pole, in half-power widths."""

    # zero_order.py
    equal_pitch: float = 1e-9
    """Pitch angles that differ by less are equal [rad]."""

    # zero_order_scan.py
    samples_per_period: int = 14
    """Samples of the scan in which the phase of the wave between two teeth turns once."""
    most_samples: int = 6000
    """Of the scan of a modal model, whose samples lie evenly."""
    deepest: float = 3.0
    """A crossing this many times deeper than the first is not closed in on."""


RULES = MethodRules()
