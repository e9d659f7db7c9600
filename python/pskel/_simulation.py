"""The simulation, with the options of ``pskel simulate`` as keyword arguments."""

from __future__ import annotations

from os import PathLike

from . import _pskel
from ._pskel import Log


class Simulation(_pskel.Simulation):
    """Closed-loop simulation: ego and actors move step by step.

    As an iterator it yields the observation of each planning step; with ``ego="caller"``, call ``act`` before the
    next one. An ego that does not follow the log drives on after its end (``is_beyond_log``).

    Parameters
    ----------
    log : Log
        Log to start from.
    ego : {"replay", "straight", "right_then_back", "cosine", "lane_change", "file", "external", "caller"}
        Policy of the ego after the warm-up: plans of ``act`` (caller), the recorded path (replay), a preset, the points of
        ``trajectory`` (file), or plans of ``planner`` (external). Only replay ends with the log.
    trajectory : path, optional
        With ``ego="file"``: the path in the ego's frame, meters forward and to the left; JSON, CSV, TXT or NPY.
        Or waypoints with times in the global frame: JSON, an object with ``waypoints``.
    reanchor : bool
        With ``ego="file"``: place the path at the ego anew at each plan, instead of once at the takeover.
    planner : str, optional
        With ``ego="external"``: a command that communicates over its standard input and output, or the socket on which it
        listens, ``unix:PATH`` or ``tcp:HOST:PORT``.
    planner_timeout : float
        Time-out for each answer of the planner, seconds.
    tracking : {"perfect", "bicycle"}
        How the ego tracks plans: exactly, or by a kinematic bicycle model with limits.
    actors : {"replay", "idm", "reactive"}
        Policy of the other actors after the warm-up.
    steps : int
        Number of simulation steps, at least 1.
    sim_hz : float, optional
        Simulation steps per second. By default 12 for nuScenes, 10 for other logs.
    plan_hz : float, optional
        Planning steps per second, a divisor of the simulation rate. By default 2 for nuScenes, 5 for other logs.
    warmup_frames : int
        The first (N - 1) ``sim_hz`` / ``plan_hz`` steps follow the log.
    start_us : int, optional
        Start time, absolute microseconds. By default the time of the first frame.
    seed : int
        Seed that is passed to planners, and part of the saved state.
    saved : str, optional
        Result of ``save`` of a simulation with the same options, to resume it.

    Raises
    ------
    ValueError
        For invalid options.
    SimulationError
        For a state of another simulation, and for a planner that cannot be started.
    """

    def __new__(
        cls,
        log: Log,
        *,
        ego: str = "caller",
        trajectory: str | PathLike[str] | None = None,
        reanchor: bool = False,
        planner: str | None = None,
        planner_timeout: float = 10.0,
        tracking: str = "perfect",
        actors: str = "replay",
        steps: int = 100,
        sim_hz: float | None = None,
        plan_hz: float | None = None,
        warmup_frames: int = 1,
        start_us: int | None = None,
        seed: int = 0,
        saved: str | None = None,
    ) -> Simulation:
        """Start the simulation."""
        return super().__new__(cls, log, locals())
