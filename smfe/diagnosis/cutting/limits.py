"""Diagnosis of stability limits: depths and chatter frequencies of cutting tests against modes and coefficients.

A condition is a limit at one spindle speed: the depth between a stable and a chattering cut, the logarithm of which
is compared, and the chatter frequency. The prediction is the zero-order limit (`methods.zero_order_scan`), times
what the converged limit of the unchanged baseline is of its zero-order limit (`methods.semi_discretization`): the
forces of few teeth change over a turn, which the mean does not know. Where the two are apart, or crossings of different
modes or lobes, that ratio corrects nothing: there the converged limit itself is fitted (`converged`), with a straight
edge and equal pitch; else the limit counts roughly only (`CuttingRules.roughly`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import HIGHEST_DAMPING, ModalModel
from process.types import Complex, Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.cutting.converged import PeriodicCut
from smfe.diagnosis.cutting.rules import RULES
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values
from stability.methods.floquet_crossings import Crossing
from stability.methods.semi_discretization import LimitDepth, limit_depth
from stability.methods.zero_order_scan import Loop, loop_of, modal_crossings, modal_eigenvalues
from stability.problem import Cut


@dataclass(frozen=True)
class Trial:
    """One cutting test."""

    spindle_speed: float  # [rpm]
    depth: float  # axial depth [m]
    chatter: bool  # whether it chattered
    frequency: float | None = None  # chatter frequency [Hz]
    frequency_std: float = 0.5  # its standard deviation [Hz]


@dataclass(frozen=True)
class Limit:
    """A limit as it was found, or one that could be looked for."""

    spindle_speed: float  # [rpm]
    depth: float | None = None  # axial depth [m]; None: not tested yet
    depth_std: float = 0.03  # standard deviation of its logarithm; the `CuttingRules.limit_floor` is added
    frequency: float | None = None  # chatter frequency [Hz]
    frequency_std: float = 0.5  # its standard deviation [Hz]; the `CuttingRules.frequency_floor` is added
    feed_per_tooth: float = 1e-4  # [m]; with the depth it sets how hard the machine is shaken
    arc: AnyEngagement | None = None  # where it differs from the family's
    name: str = ""  # for people; default made of speed and feed per tooth

    @property
    def words(self) -> str:
        """What it is called."""
        return self.name or f"limit at {self.spindle_speed:.6g} rpm, {self.feed_per_tooth * 1e3:.3g} mm per tooth"


@dataclass(frozen=True)
class KnownLimit:
    """A limit with the correction of its zero-order prediction: converged over zero-order depth and frequency."""

    limit: Limit
    depth_ratio: float
    frequency_ratio: float
    periodic: tuple[Crossing, ...] = ()
    """Converged crossings of the baseline, where these themselves are fitted; the ratios then are those of the mesh."""

    @property
    def elsewhere(self) -> bool:
        """Whether the converged limit is another crossing than the zero-order limit."""
        return abs(self.frequency_ratio - 1.0) > RULES.alike

    @property
    def rough(self) -> bool:
        """Whether zero order does not describe the cut: the converged limit is elsewhere, or far from it."""
        return self.elsewhere or abs(math.log(self.depth_ratio)) > RULES.most_corrected

    @property
    def comparable_frequency(self) -> float | None:
        """Chatter frequency as the zero-order limit has it [Hz]; None where there is none to compare."""
        f = self.limit.frequency
        return None if f is None or self.elsewhere else f / self.frequency_ratio

    def std(self) -> Real:
        """Standard deviations of log depth and, where it can be compared, frequency [Hz]."""
        correction = RULES.floor_of_correction * abs(math.log(self.depth_ratio))
        setting = RULES.depth / (self.limit.depth or math.inf)
        rough = RULES.roughly if self.rough else 0.0
        depth = math.hypot(self.limit.depth_std, RULES.limit_floor, correction, setting, rough)
        observed = self.comparable_frequency
        if self.limit.depth is not None and observed is None:
            return np.array([depth])
        return np.array([depth, math.hypot(self.limit.frequency_std, RULES.frequency_floor * (observed or 0.0))])

    def whitened(self, depth: float, frequency: float) -> Real:
        """Return depth [m] and frequency [Hz] as a family compares them."""
        std = self.std()
        return np.asarray(np.array([math.log(depth), frequency])[: std.size] / std)

    def measured(self) -> Real:
        """Return what was found, as a family compares it."""
        assert self.limit.depth is not None
        return self.whitened(self.limit.depth, self.comparable_frequency or 0.0)

    def crossing(self, depth: Real, frequency: Real) -> int:
        """Return which of the zero-order crossings, the shallowest first, has the frequency that was observed."""
        observed = self.comparable_frequency
        return 0 if observed is None else _observed_crossing(depth, frequency, observed)

    def predicted(self, depth: Real, frequency: Real) -> Real:
        """Return what zero-order crossings predict, depths [m] with the shallowest first and frequencies [Hz]."""
        return self.whitened(float(depth[0]) * self.depth_ratio, float(frequency[self.crossing(depth, frequency)]))


def bracketed(trials: Sequence[Trial], feed_per_tooth: float = 1e-4) -> tuple[tuple[Limit, ...], tuple[str, ...]]:
    """Turn stable and chattering tests into limits: one a spindle speed, at the geometric mean of its bracket.

    The logarithm of a limit is spread evenly between the deepest stable and the shallowest chattering depth: its
    standard deviation is that of a uniform spread, ``log(d2/d1)/sqrt(12)``.

    Parameters
    ----------
    trials : sequence of Trial
        At several speeds and depths.
    feed_per_tooth : float, optional
        Of all [m].

    Returns
    -------
    tuple of Limit, tuple of str
        Limits, and sentences about speeds that gave none.

    Raises
    ------
    InputError
        When a depth is not positive.
    """
    if any(not t.depth > 0.0 for t in trials):
        raise InputError("a cutting test has a depth that is not positive; give depths in m")
    limits, notes = [], []
    for speed in sorted({t.spindle_speed for t in trials}):
        stable = [t.depth for t in trials if t.spindle_speed == speed and not t.chatter]
        chattering = sorted((t for t in trials if t.spindle_speed == speed and t.chatter), key=lambda t: t.depth)
        if not stable or not chattering:
            side = "chattered" if chattering else "was stable"
            notes.append(f"at {speed:g} rpm every cut {side}: the limit is not bracketed; cut on the other side of it")
        elif max(stable) >= chattering[0].depth:
            notes.append(
                f"at {speed:g} rpm {max(stable) * 1e3:g} mm was stable and {chattering[0].depth * 1e3:g} mm chattered: "
                "one depth is no limit there (an island, or a wrong verdict)"
            )
        else:
            width = math.log(chattering[0].depth / max(stable))
            middle = math.sqrt(chattering[0].depth * max(stable))
            seen = next((t for t in chattering if t.frequency is not None), chattering[0])
            spread = width / math.sqrt(12.0)
            limits.append(Limit(speed, middle, spread, seen.frequency, seen.frequency_std, feed_per_tooth))
    return tuple(limits), tuple(notes)


@dataclass(frozen=True)
class Spread:
    """How well the modal model is known before a cut: standard deviations, relative."""

    frequency: float = 0.005
    damping: float = 0.1
    stiffness: float = 0.03


@dataclass(frozen=True)
class CuttingLimits(Abilities):
    """A family for `smfe.diagnosis.judgement.diagnose`: limits of one tool on one machine; see `limit_family`."""

    machine: ModalModel  # as identified at rest, or in motion
    tool: Tool  # diameter, teeth, approach angle
    arc: AnyEngagement  # of all limits that have none of their own
    coefficients: CuttingCoefficients  # as given
    conditions: tuple[Condition, ...]  # measured limits
    proposals: tuple[Condition, ...] = ()  # limits that could be looked for
    spread: Spread = field(default_factory=Spread)  # priors of the machine
    tolerances: Tolerances = field(default_factory=Tolerances)  # priors of the coefficients
    stated: tuple[str, ...] = ()  # causes of which the uncertainty was given: "modal_scale", "force_coefficients"
    kept: dict[object, tuple[PeriodicCut, Crossing, Crossing, float]] = field(
        default_factory=dict, compare=False, repr=False
    )  # converged limits of the last values

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Frequency, damping and stiffness of each mode, and the cutting coefficients, relative to what was given.

        Hammer and accelerometer scale the compliance of all modes alike, as a harder work does what is cut: that is one
        number, with a name. Of each mode by itself there are so many that together they imitate whatever a cut does to
        a machine: moved beyond what is trusted of them they are no cause.
        """
        stated = "modal_scale" in self.stated
        kinds = (
            ("frequency", self.spread.frequency),
            ("damping", self.spread.damping),
            ("stiffness", self.spread.stiffness),
        )
        modes = (
            Parameter(
                f"{name}_{r + 1}",
                "%",
                0.0,
                0.5 * sd,
                -0.8,
                4.0,
                sd,
                100.0,
                given=f"modal_{name}",
                stated=stated,
                nameless=True,
                said=f"{name} of mode {r + 1}",
            )
            for r in range(self.machine.frequency.size)
            for name, sd in kinds
        )
        sd, of = RULES.common * self.spread.stiffness, ("modal_scale", stated)
        said = "stiffness and mass of all modes"
        common = Parameter("scale_error", "%", 0.0, 0.5 * sd, -0.8, 4.0, sd, 100.0, *of, said=said)
        return (*modes, common, *material_nuisances(self.tolerances, "force_coefficients" in self.stated))

    @property
    def masks(self) -> bool:
        """Every limit goes with one over the coefficients, and whatever else is wrong raises or lowers many of them."""
        return True

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the square of the relative error of the limit depth, for a whitened misfit."""
        return float((misfit[0] * _known(condition).std()[0]) ** 2)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What such a prediction lacks."""
        speeds = [_limit(c).spindle_speed for c in self.conditions] or [1000.0]
        return _catalogue(self.machine, self._flank_scale(min(speeds)))

    def _flank_scale(self, slowest: float) -> float:
        """Process damping [N/m] that turns the force by about 0.05 rad at a speed [rpm]."""
        speed = math.pi * self.tool.diameter * slowest / 60.0
        return 0.05 * self.coefficients.Ktc * speed / (2.0 * math.pi * float(self.machine.frequency.max()))

    def changed(self, values: Values, limit: Limit) -> ModalModel:
        """Return the machine under a set of values, as a limit sees it."""
        m, modes = self.machine, range(1, self.machine.frequency.size + 1)

        def of(name: str) -> Real:
            return np.array([values.get(f"{name}_{r}", 0.0) for r in modes])

        share = limit.spindle_speed / self._fastest()
        slip = np.clip(of("micro_slip") * self._level(limit), 0.0, 0.9)
        # What turns changes the stiffness, with the square of the speed where it is pulled outwards; its mass stays.
        pulled = 1.0 + ((1.0 + of("square")) ** 2 - 1.0) * share**2
        softer = np.maximum((1.0 + of("linear") * share) ** 2 * pulled, RULES.softest)
        kept = softer * (1.0 - slip)
        frequency = m.frequency * (1.0 + of("frequency")) * np.sqrt(kept)
        # Iwan's joint: loss stiffness 4/(3 pi) of the stiffness that it loses, over twice what is left.
        damping = m.damping * (1.0 + of("damping")) + 2.0 / (3.0 * math.pi) * slip / (1.0 - slip)
        stiffness = m.stiffness * (1.0 + values.get("scale_error", 0.0)) * (1.0 + of("stiffness")) * kept
        damping = np.minimum(damping, HIGHEST_DAMPING)
        model = ModalModel(frequency, damping, stiffness, _turned(m.direction, of("coupling")))
        return _with_mode(model, values)

    def _fastest(self) -> float:
        return max((_limit(c).spindle_speed for c in self.conditions), default=1000.0)

    def _level(self, limit: Limit) -> float:
        """Cross-section of the chip over the largest that was cut; of a limit not known yet, over that of the mean."""
        known = [(_limit(c).depth or 0.0) * _limit(c).feed_per_tooth for c in self.conditions]
        largest = max(known, default=0.0)
        if largest == 0.0:
            return 0.0
        if limit.depth is not None:
            return limit.depth * limit.feed_per_tooth / largest
        typical = float(np.mean([_limit(c).depth or 0.0 for c in self.conditions]))
        return typical * limit.feed_per_tooth / largest

    def material(self, values: Values) -> CuttingCoefficients:
        """Return the cutting coefficients of a set of values."""
        return material_of(self.coefficients, values)

    def limits_at(self, limit: Limit, values: Values) -> tuple[Real, Real]:
        """Return zero-order depth [m] and chatter frequency [Hz] of all crossings, the first one first."""
        return modal_crossings(self.changed(values, limit), self._loop(limit, values))

    def _loop(self, limit: Limit, values: Values) -> Loop:
        flank = ProcessDamping(values.get("process_damping", 0.0), RULES.flank_friction)
        return loop_of(self.tool, limit.arc or self.arc, self.material(values), limit.spindle_speed, flank)

    def roughly(self) -> list[tuple[str, float]]:
        """Return the measured limits that zero order does not describe, and how well each is predicted (logarithm)."""
        return [(c.name, float(k.std()[0])) for c in self.conditions if (k := _known(c)).rough]

    @property
    def measured(self) -> list[tuple[Condition, Limit]]:
        """The limits that were found, with their conditions."""
        return [(c, _limit(c)) for c in self.conditions]

    def found(self, condition: Condition) -> tuple[float, float | None]:
        """Return spindle speed [rpm] and depth [m] of a limit as it was found."""
        limit = _limit(condition)
        return limit.spindle_speed, limit.depth

    def depth(self, condition: Condition, values: Values) -> float:
        """Return the depth of a limit that a set of values predicts [m]; infinite where no depth is unstable."""
        known = _known(condition)
        if known.periodic:
            return self._converged(known, values)[1].depth * known.depth_ratio
        depth, _ = self.limits_at(known.limit, values)
        return float(depth[0]) * known.depth_ratio if depth.size else math.inf

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return log depth and chatter frequency, whitened like the data; `InputError` where no depth is unstable."""
        known = _known(condition)
        if known.periodic:
            cut, first, _, turns = self._converged(known, values)
            return known.whitened(first.depth * known.depth_ratio, abs(turns) / cut.period)
        depth, frequency = self.limits_at(known.limit, values)
        if not depth.size:
            raise InputError(
                f"{known.limit.words}: this machine does not chatter at any depth; check modes and coefficients"
            )
        return known.predicted(depth, frequency)

    def _cut(self, limit: Limit, values: Values, flank: float = 0.0) -> Cut:
        """Return the cut of a limit, its flank [N/m] resisting at least so much."""
        worn = ProcessDamping(max(values.get("process_damping", 0.0), flank), RULES.flank_friction)
        return Cut(self.tool, limit.arc or self.arc, self.material(values), worn)

    def _converged(self, known: KnownLimit, values: Values) -> tuple[PeriodicCut, Crossing, Crossing, float]:
        """Return the cut of a limit, its first crossing, the one observed, and the turns of that one's line."""
        limit = known.limit
        key = limit.words, limit.spindle_speed, limit.depth, tuple(values.items())
        if key not in self.kept:
            if len(self.kept) >= RULES.kept_cuts:
                self.kept.clear()
            cut = PeriodicCut.of(self.changed(values, limit), self._cut(limit, values), limit.spindle_speed)
            mean = partial(self.limits_at, limit, values)
            crossings = cut.crossings(RULES.deepest_observed * (limit.depth or math.inf), known.periodic, mean)
            if not crossings:
                raise InputError(
                    f"{limit.words}: this machine does not chatter at any depth; check modes and coefficients"
                )
            seen = (crossings[0], 0.0) if limit.frequency is None else cut.observed(crossings, limit.frequency)
            self.kept[key] = cut, crossings[0], *seen
        return self.kept[key]

    def _periodic_slopes(self, known: KnownLimit, values: Values, parameters: Sequence[Parameter]) -> Real:
        """Return the derivatives of a converged limit with parameters, over their scales."""
        std = known.std()
        cut, first, seen, turns = self._converged(known, values)
        # A flank that does nothing has no contacts: where it may begin to resist, it resists a little.
        flank = _STEP * sum(p.scale for p in parameters if p.name == "process_damping")
        if values.get("process_damping", 0.0) < flank:
            cut = cut.with_cut(self._cut(known.limit, values, flank))
        moved = []
        for p in parameters:
            beside = {**values, p.name: values.get(p.name, p.start) + _STEP * p.scale}
            if p.name in ("coefficients", "radial", "process_damping"):
                if p.name == "process_damping":
                    beside[p.name] += flank if values.get(p.name, 0.0) < flank else 0.0
                moved.append(cut.with_cut(self._cut(known.limit, beside, flank)))
            else:
                moved.append(cut.with_machine(self.changed(beside, known.limit)))
        rows = np.zeros((std.size, len(parameters)))
        rows[0] = -cut.slopes(first, moved)[0] * first.depth / _STEP / std[0]
        if std.size == 2:
            turned = cut.slopes(seen, moved)[1] / _STEP
            rows[1] = math.copysign(1.0, turns) * turned / (2.0 * math.pi * cut.period) / std[1]
        return rows

    def slopes(
        self, conditions: Sequence[Condition], values: Values, parameters: Sequence[Parameter]
    ) -> Sequence[Real] | None:
        """Return the derivatives of each limit with parameters, over their scales, (n, p): of an implicit function.

        At a crossing an eigenvalue ``L(f, p) = 1/b`` is real, so that ``Im(L_f df + L_p dp) = 0`` gives the frequency
        and ``d(1/b) = Re(L_f df + L_p dp)`` the depth; `L` at one frequency costs a hundredth of a scan.
        """
        found = []
        for c in conditions:
            known = _known(c)
            if known.periodic:
                try:
                    rows = self._periodic_slopes(known, values, parameters)
                except (InputError, np.linalg.LinAlgError):
                    return None
                if not np.all(np.isfinite(rows)):
                    return None
                found.append(rows)
                continue
            depth, frequency = self.limits_at(known.limit, values)
            if not depth.size:
                return None
            std = known.std()
            both = [(0, 0)] if std.size == 1 else [(0, 0), (1, known.crossing(depth, frequency))]
            rows = np.zeros((std.size, len(parameters)))
            at = np.array([frequency[k] for _, k in both])
            expected = np.array([1.0 / depth[k] for _, k in both])
            here = self._eigenvalue(known.limit, values, at, expected)
            over = (self._eigenvalue(known.limit, values, at * (1.0 + _STEP), expected) - here) / (at * _STEP)
            if not np.all(np.abs(over.imag) > 1e-9 * np.abs(over)):
                return None
            for n, p in enumerate(parameters):
                moved = {**values, p.name: values.get(p.name, p.start) + _STEP * p.scale}
                change = (self._eigenvalue(known.limit, moved, at, expected) - here) / _STEP
                shift = -change.imag / over.imag
                rows[0, n] = -(change.real + over.real * shift)[0] / expected[0] / std[0]
                if std.size == 2:
                    rows[1, n] = shift[1] / std[1]
            found.append(rows)
        return found

    def _eigenvalue(self, limit: Limit, values: Values, frequency: Real, expected: Real) -> Complex:
        """Return at each frequency [Hz] the eigenvalue [1/m] nearest to one that is expected."""
        each = modal_eigenvalues(self.changed(values, limit), self._loop(limit, values), frequency)
        nearest = np.argmin(np.abs(each - expected[:, None]), axis=1)
        return np.asarray(each[np.arange(frequency.size), nearest])


_STEP = 1e-5
"""Of a difference, in scales of a parameter and relative to a frequency: eigenvalues at one frequency are smooth."""


def material_nuisances(tolerances: Tolerances, stated: bool) -> tuple[Parameter, ...]:
    """Return what may be wrong with the cutting coefficients of a limit: their size, and radial over tangential."""
    sd = max(tolerances.coefficients, RULES.exact)
    of = "force_coefficients", stated
    size, ratio = "cutting coefficients, all together", "radial over tangential coefficient"
    return (
        Parameter("coefficients", "%", 0.0, 0.5 * sd, -0.9, 9.0, sd, 100.0, *of, said=size),
        Parameter("radial", "%", 0.0, 0.5 * sd, -0.9, 4.0, sd, 100.0, *of, said=ratio),
    )


def material_of(given: CuttingCoefficients, values: Values) -> CuttingCoefficients:
    """Return the cutting coefficients of a set of values."""
    grown, ratio = 1.0 + values.get("coefficients", 0.0), 1.0 + values.get("radial", 0.0)
    return replace(given, Ktc=given.Ktc * grown, Krc=given.Krc * grown * ratio, Kac=given.Kac * grown)


def _limit(condition: Condition) -> Limit:
    return _known(condition).limit


def _known(condition: Condition) -> KnownLimit:
    assert isinstance(condition.data, KnownLimit)
    return condition.data


def _observed_crossing(depth: Real, frequency: Real, observed: float) -> int:
    """Return which crossing was observed: near the first in depth, and near what was observed.

    A cut some per cent too deep may chatter at the lobe beside the deepest valley. Modes are known within a few per
    cent: a frequency further from the first crossing than that is of another one, however deep, and it is the depth
    that the first one has wrong.
    """
    return int(np.argmin(_distances(depth, frequency, observed)))


def _distances(depth: Real, frequency: Real, observed: float) -> Real:
    """Return how far crossings are from the first in depth and from what was observed, squared."""
    excess = np.log(depth / depth[0]) / RULES.near
    away = np.abs(frequency / observed - 1.0) / RULES.near_observed
    return np.asarray(excess**2 + away**2)


def _turned(direction: Real, angle: Real) -> Real:
    """Turn each mode about z by an angle [rad]."""
    if not np.any(angle):
        return direction
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = direction.T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


def _with_mode(model: ModalModel, values: Values) -> ModalModel:
    """Add the mode that is missing; one of no compliance is none."""
    size = values.get("mode_compliance", 0.0)
    if size <= 0.0:
        return model
    azimuth = values["mode_azimuth"]
    return ModalModel(
        np.append(model.frequency, values["mode_frequency"]),
        np.append(model.damping, values["mode_damping"]),
        np.append(model.stiffness, 1.0 / size),
        np.vstack([model.direction, [math.cos(azimuth), math.sin(azimuth), 0.0]]),
    )


def _catalogue(machine: ModalModel, flank: float) -> tuple[Cause, ...]:
    count = machine.frequency.size
    modes = range(1, count + 1)
    both = machine.direction[:, :2].any(axis=0).all()

    def each(
        name: str, unit: str, scale: float, low: float, high: float, shown: float = 100.0
    ) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"{name}_{r}", unit, 0.0, scale, low, high, shown=shown) for r in modes)

    damping = Parameter("process_damping", "N/mm", 0.0, flank, 0.0, 1e4 * flank, shown=1e-3)
    turning = "modes that change with the speed of the spindle"
    # Where another lobe comes to govern a limit has a kink, where an island of instability opens below it a jump: no
    # slope leads from there to an effect of some size.
    soft, stiff = ((sign * RULES.softened,) * count for sign in (-1.0, 1.0))
    found = [
        Cause("process_damping", "damping by the worn flank", (damping,), starts=((5.0 * flank,),)),
        Cause("spindle_speed_dynamics", turning, each("linear", "%", 0.01, -0.5, 0.5), "linear", starts=(soft, stiff)),
        Cause("spindle_speed_dynamics", turning, each("square", "%", 0.01, -0.5, 0.5), "square", starts=(soft, stiff)),
        Cause("joint_micro_slip", "micro-slip in a joint", each("micro_slip", "%", 0.02, 0.0, 0.8)),
    ]
    if both:
        turn = each("coupling", "deg", 0.03, -0.8, 0.8, 180.0 / math.pi)
        starts = tuple(
            tuple(sign * RULES.turned * (r == turned) for r in range(count))
            for turned in range(count)
            for sign in (1.0, -1.0)
        )
        title = "directions of the modes: axes that are coupled"
        found.append(Cause("cross_axis_coupling", title, turn, starts=starts))
    return (*found, _missing(machine))


def _missing(machine: ModalModel) -> Cause:
    low, high = 0.5 * float(machine.frequency.min()), 3.0 * float(machine.frequency.max())
    usual = float(1.0 / machine.stiffness.min())
    parameters = (
        Parameter("mode_compliance", "um/N", 0.0, 0.02 * usual, 0.0, 10.0 * usual, shown=1e6),
        Parameter("mode_frequency", "Hz", math.sqrt(low * high), 0.02 * high, low, high),
        Parameter("mode_damping", "%", 0.04, 0.01, 0.005, 0.3, shown=100.0, secondary=True),
        Parameter("mode_azimuth", "deg", 0.0, 0.3, -math.pi, math.pi, shown=180.0 / math.pi, secondary=True),
    )
    # A mode acts over a few times its damping: further apart a start between two others leads elsewhere. Those inside
    # a peak are none.
    least, most = (f * share for f, share in zip((low, high), RULES.missing_from, strict=True))
    places = np.geomspace(least, most, math.ceil(math.log(most / least) / RULES.missing_step))
    away = np.abs(places[:, None] / machine.frequency - 1.0) > machine.damping
    places = places[away.all(axis=1)]
    starts = tuple((0.1 * usual, float(f), 0.04, a) for f in places for a in (0.01, 0.5 * math.pi))
    title = "a mode that the model does not have"
    return Cause("missing_mode", title, parameters, starts=starts, beyond=partial(_inside_a_peak, machine))


def _inside_a_peak(machine: ModalModel, values: Mapping[str, float]) -> str:
    """Say of which mode the peak holds one that is missing; "" for none.

    Between its half-power points, with more of its compliance along it than `RULES.in_a_peak`, it is what was
    identified as that mode: a compliance of it that is wrong, and no mode of its own.
    """
    if values.get("mode_compliance", 0.0) <= 0.0:
        return ""
    azimuth = values["mode_azimuth"]
    along = np.abs(machine.direction @ [math.cos(azimuth), math.sin(azimuth), 0.0])
    away = np.abs(values["mode_frequency"] / machine.frequency - 1.0)
    (inside,) = np.nonzero((away < machine.damping) & (along**2 > RULES.in_a_peak))
    return f"mode_frequency (inside the peak of mode {inside[0] + 1})" if inside.size else ""


def limit_family(
    limits: Sequence[Limit],
    machine: ModalModel,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    proposals: Sequence[Limit] | None = None,
    spread: Spread | None = None,
    costs: Mapping[str, float] | None = None,
    tolerances: Tolerances | None = None,
    stated: Sequence[str] = (),
) -> CuttingLimits:
    """Build the family of the limits that cutting tests found.

    Parameters
    ----------
    limits : sequence of Limit
        With their depths.
    machine : ModalModel
        As identified.
    tool, arc, coefficients
        The cut.
    proposals : sequence of Limit, optional
        What could be looked for next; default `further`.
    spread : Spread, optional
        How well the machine is known.
    costs : mapping, optional
        Words of a proposal -> what it takes [min]; default `CuttingRules.minutes` each.
    tolerances : Tolerances, optional
        How well the coefficients are known; default that of a workshop.
    stated : sequence of str, optional
        Which were given with their uncertainty ("modal_scale", "force_coefficients"); else less may matter too.

    Returns
    -------
    CuttingLimits
        For `smfe.diagnosis.judgement.diagnose.diagnose`.

    Raises
    ------
    InputError
        Without a limit, or for one whose depth or speed is not positive.
    """
    if not limits:
        raise InputError("no limit to diagnose; bracket the limit at one spindle speed at least")
    for limit in limits:
        if limit.depth is None or not limit.depth > 0.0 or not limit.spindle_speed > 0.0:
            raise InputError(f"{limit.words}: depth {limit.depth} m; depth and speed must be known and positive")
    new = further(limits) if proposals is None else tuple(proposals)
    plain = CuttingLimits(machine, tool, arc, coefficients, ())
    known = [_corrected(plain, limit) for limit in (*limits, *new)]
    tested = tuple(_condition(k, {}) for k in known[: len(limits)])
    minutes = costs or {}
    proposed = tuple(
        _condition(k, {"minutes": minutes.get(k.limit.words, RULES.minutes)})
        for k in known[len(limits) :]
        if k.limit.words not in {c.name for c in tested}
    )
    return replace(
        plain,
        conditions=tested,
        proposals=proposed,
        spread=spread or Spread(),
        tolerances=tolerances or Tolerances(),
        stated=tuple(stated),
    )


def _corrected(plain: CuttingLimits, limit: Limit) -> KnownLimit:
    """Compare the converged limit of the baseline with its zero-order limit."""
    cut = plain.tool, limit.arc or plain.arc, plain.coefficients
    zero_order = plain.limits_at(limit, {})
    found = corrected(limit, zero_order, partial(limit_depth, plain.machine, *cut, limit.spindle_speed))
    straight = plain.tool.helix_angle == 0.0 and plain.tool.equal_pitch and limit.depth is not None
    if straight and zero_order[0].size and _beyond_zero_order(found, *zero_order):
        here = PeriodicCut.of(plain.machine, plain._cut(limit, {}), limit.spindle_speed)
        crossings = here.crossings(RULES.deepest_observed * (limit.depth or math.inf))
        if crossings:
            # What the mesh that is fitted is off by.
            ratio = found.depth_ratio * float(zero_order[0][0]) / crossings[0].depth
            ratio = ratio if abs(ratio - 1.0) < RULES.mesh_error else 1.0
            return KnownLimit(limit, ratio, 1.0, tuple(crossings))
    return found


def _beyond_zero_order(known: KnownLimit, depth: Real, frequency: Real) -> bool:
    """Whether a limit needs its converged prediction: zero order is far from it, or has no such crossing.

    A cut over a period chatters with lines that lie a tooth passing apart, of which the mean knows one.
    """
    if known.rough or abs(math.log(known.depth_ratio)) > RULES.little_corrected:
        return True
    observed = known.comparable_frequency
    return observed is not None and float(_distances(depth, frequency, observed).min()) > RULES.not_observed**2


def corrected(limit: Limit, zero_order: tuple[Real, Real], converged: Callable[[], LimitDepth]) -> KnownLimit:
    """Return a limit with what its converged prediction is of the zero-order one; both are one where there is none.

    `zero_order` holds depths [m], the shallowest first, and frequencies [Hz].
    """
    depth, frequency = zero_order
    found = converged() if depth.size else None
    if found is None or not math.isfinite(found.limit_depth_mm):
        return KnownLimit(limit, 1.0, 1.0)
    return KnownLimit(
        limit, 1e-3 * found.limit_depth_mm / float(depth[0]), found.chatter_frequency_Hz / float(frequency[0])
    )


def _condition(known: KnownLimit, more: dict[str, float | str]) -> Condition:
    limit = known.limit
    settings = {"spindle_speed": limit.spindle_speed, "feed_per_tooth": limit.feed_per_tooth, **more}
    if limit.depth is None:
        return Condition(limit.words, settings, None, "", known)
    return Condition(limit.words, settings, known.measured(), "", known)


def further(limits: Sequence[Limit]) -> tuple[Limit, ...]:
    """Return limits that could be looked for: other speeds, and a harder feed per tooth."""
    speeds = sorted({v.spindle_speed for v in limits})
    plain = replace(limits[0], depth=None, frequency=None, name="")
    new = (0.5 * speeds[0], 0.7 * speeds[0], 1.4 * speeds[-1], 2.0 * speeds[-1])
    others = tuple(replace(plain, spindle_speed=float(f"{n:.3g}")) for n in new)
    return (*others, replace(plain, spindle_speed=speeds[0], feed_per_tooth=3.0 * plain.feed_per_tooth))
