"""The live viewer: a plant on a local page, to be dragged with the mouse (viser's home).

One thread computes. Callbacks of the page only leave work for it: jobs in order, of a
drag's positions the latest alone, so that the plant follows the hand however many tabs are
open. All tabs show the same plant.
"""

import contextlib
import io
import logging
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from plantsim.arrays import Array
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError, PlantsimError
from plantsim.estimation.observation import Observation
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.hung import Masses
from plantsim.view.hand import Goal, steps
from plantsim.view.panel import Panel
from plantsim.view.skin import Skin
from plantsim.view.style import CONTACT, MOVED, plain, rgb
from plantsim.view.touching import Balance, Burden, Frame, Touching, beside, hit

LOOPBACK = "127.0.0.1"
PORT = 8080
SLOW = 1 / 5  # [s] between words and colours that change in a drag; the shape goes at once
AIM = 0.015  # [rad] by which a click may miss the plant: some ten pixels
TRIES = 10  # equilibria for one place of the hand, which turns with each
REST = 0.25  # [s] without a job until what costs more than a frame is told
DEFAULT = Material(6e9, 0.35, 900.0)
log = logging.getLogger(__name__)


class Local(viser.ViserServer):
    """A server that no page can put on the open network by asking for a shared address."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse."""
        del verbose


class Viewer:
    """A page on which a plant is dragged. `with Viewer(mesh) as v: v.wait()`.

    `host`: loopback only by default; whoever reaches another address may drag the plant and
    load files into it, without a password. `port` 0 takes any free one. `touches`: the file
    to which recorded touches are written, of the kind that `ps.write_observations` knows.
    """

    def __init__(
        self,
        mesh: TetMesh,
        material: Material = DEFAULT,
        *,
        name: str = "plant",
        masses: Masses | None = None,
        fixed: Any = "base",
        host: str = LOOPBACK,
        port: int = PORT,
        touches: Path | None = None,
    ) -> None:
        """Prepare the model and open the page."""
        self.touches_file = touches
        self.recorded: list[Observation] = []
        self.frames = 0  # since the start
        self.frame_seconds = 0.0  # that the last frame took to compute and send
        self.frame: Frame | None = None
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._goal: Goal | None = None
        self._heard = 0.0  # when the page last told of a drag
        self._burden: Burden | None = None
        self.balancing: Touching | None = None  # for which an equilibrium is solved for
        self.tries = TRIES  # for balance, that are left at this place of the hand
        self._lock = threading.Lock()
        self._trace: list[tuple[float, float]] = []
        self._spoke = self._typical = 0.0
        self._told = True
        self._start, self._met = np.zeros(3), Goal(np.zeros(3))
        self._gizmo: Any = None
        with contextlib.redirect_stdout(io.StringIO()):  # its own banner
            self.server = Local(host=host, port=port, label="plantsim", verbose=False)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self.server.scene.set_up_direction("+z")
        self.server.scene.on_click()(self._clicked)
        self.panel = Panel(self.server, self)
        self.show(mesh, material, name=name, masses=masses, fixed=fixed)
        self._thread = threading.Thread(target=self._work, name="plantsim", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self.server.get_host().replace("0.0.0.0", "localhost") or "localhost"
        return f"http://{host}:{self.server.get_port()}"

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *why: object) -> None:
        self.stop()

    def wait(self) -> None:
        """Stay until Ctrl-C, or until the thread that computes has ended."""
        with contextlib.suppress(KeyboardInterrupt):
            while self._thread.is_alive():
                self._thread.join(1.0)

    def stop(self) -> None:
        """Close the page and end the threads."""
        self._jobs.put(None)
        self._thread.join(timeout=10)
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    # what is done to the plant; each leaves the work to the one thread

    def do(self, job: Callable[[], None]) -> None:
        """Leave a job to the thread that computes."""
        self._jobs.put(job)

    def settle(self, timeout: float = 60.0) -> None:
        """Wait until all jobs left so far are done."""
        done = threading.Event()
        self._jobs.put(done.set)
        if not done.wait(timeout):
            raise TimeoutError(f"the viewer was still at work after {timeout} s")

    def show(
        self,
        mesh: TetMesh,
        material: Material = DEFAULT,
        *,
        name: str = "plant",
        masses: Masses | None = None,
        fixed: Any = "base",
    ) -> None:
        """Show another plant."""
        model = ElasticModel(mesh, material, fixed=fixed)
        model.base_factor()
        self.take(Touching(model, masses), name)

    def take(self, touching: Touching, name: str) -> None:
        """Show a plant that is ready to be touched."""
        self.touching, self.name = touching, name
        self.prior: ElasticModel = touching.model
        self.found: Any = None
        self.recorded.clear()
        mesh = touching.mesh
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        self.span = float((high - low).max())
        self._drop_gizmo()
        scene = self.server.scene
        scene.reset()
        # where no graphics card draws, an environment's light takes a third of the pictures
        scene.configure_environment_map(None)
        scene.configure_default_lights(cast_shadow=False)  # a shadow, nine in ten
        scene.add_light_hemisphere("/sky", ground_color=(90, 90, 90), intensity=2.4)
        scene.add_grid(
            "/ground",
            width=2 * self.span,
            height=2 * self.span,
            cell_size=self.span / 10,
            section_size=self.span / 2,
            position=(0.0, 0.0, float(low[2])),
        )
        self.skin = Skin(scene, touching)
        self._arrow = scene.add_arrows(
            "/force",
            np.zeros((1, 2, 3)),
            rgb(CONTACT),
            shaft_radius=0.006 * self.span,
            head_radius=0.014 * self.span,
            head_length=0.035 * self.span,
            visible=False,
        )
        self._label = scene.add_label("/newtons", "", visible=False, anchor="bottom-left")
        self._dots = scene.add_point_cloud(
            "/held", np.zeros((1, 3)), rgb(MOVED), point_size=0.008 * self.span
        )
        self._dots.visible = False
        camera, middle = self.server.initial_camera, (low + high) / 2
        camera.position = tuple(middle + self.span * np.array([0.65, -0.8, 0.15]))
        camera.look_at = tuple(middle)
        self.panel.new_plant()
        self._draw(touching.let_go())

    def touch_instead(self, touching: Touching) -> None:
        """Touch the same mesh by another model; the hand is opened, the estimate kept."""
        self.touching = touching
        self._let_go()

    def hold(self, ids: Any) -> None:
        """Take hold of vertices and put the gizmo there."""
        self.do(lambda: self._hold(np.asarray(ids)))

    def drag(self, shift: Any, turn: Any = None) -> None:
        """Move the hand by a shift [m] from rest.

        `turn`: a rotation vector [rad] that is held; None: it turns as the plant likes.
        """
        self._lead(Goal(np.asarray(shift, dtype=float), turn))

    def let_go(self) -> None:
        """Open the hand."""
        self.do(self._let_go)

    def bear(self, burden: Burden) -> None:
        """Put another burden on the plant; of several that wait, the latest."""
        with self._lock:
            waiting = self._burden is not None
            self._burden = burden
        if not waiting:
            self.do(self._bear)

    def uncertainty(self) -> Array | None:
        """Return the standard deviation (m,) [%] of each tet's modulus, if known."""
        try:
            return 100 * self.found.tet_std
        except EstimateError as why:  # not every method knows
            self.panel.complain(str(why))
            return None

    # the thread

    def _lead(self, goal: Goal) -> None:
        with self._lock:
            waiting = self._goal is not None
            self._goal = goal
        if not waiting:
            self._jobs.put(self._follow)

    def _work(self) -> None:
        while True:
            try:
                job = self._jobs.get(timeout=REST)
            except queue.Empty:
                job = self._rest_a_moment
            if job is None:
                return
            try:
                job()
            except (PlantsimError, OSError) as why:
                self.panel.complain(str(why))
            except Exception as why:  # a viewer that dies of one click helps nobody
                log.exception("in the viewer")
                self.panel.complain(f"{type(why).__name__}: {why}")

    def _follow(self) -> None:
        with self._lock:
            goal, self._goal = self._goal, None
            if goal is None or not len(self.touching.ids):
                return
            self._goal = goal.rest()
            if self._goal is not None:
                self._jobs.put(self._follow)
        began = time.perf_counter()
        self._met, self.tries = goal.first(self._met), TRIES
        self._draw(self.touching.drag(self._met.shift, self._met.turn))
        self.frame_seconds = time.perf_counter() - began
        self.frames += 1
        self._balance()
        time.sleep(max(self._met.pace - self.frame_seconds, 0.0))

    def _bear(self) -> None:
        with self._lock:
            burden, self._burden = self._burden, None
        if burden is None:
            return
        if not self.touching.linear:
            self.panel.busy("solving for balance under the burden")
        frame = self.touching.bear(burden)
        if self._gizmo is not None:
            self._gizmo.position = tuple(frame.centre)
            self._start = frame.centre - self._met.shift
        self._trace.clear()
        self._draw(frame)
        self._balance()

    def _balance(self) -> None:
        """Solve for balance beside the frames, where they run ahead of it."""
        touching = self.touching
        solve = None if self.balancing is touching else touching.correction()
        if solve is None or self.tries <= 0:
            return
        self.balancing, self.tries = touching, self.tries - 1

        def run() -> None:
            try:
                found = solve()
            except Exception as why:
                self.panel.complain(f"no balance here: {why}")
                self.do(lambda: self._balanced(touching, None))
            else:
                self.do(lambda: self._balanced(touching, found))

        threading.Thread(target=run, name="plantsim balance", daemon=True).start()

    def _balanced(self, touching: Touching, found: Balance | None) -> None:
        if self.balancing is touching:
            self.balancing = None
        if touching is not self.touching or found is None:
            return
        if not found.whole:
            self.panel.complain("The plant cannot be bent so far. Let the hand come back.")
            self.tries = 0
        self._draw(touching.correct(found))
        self._balance()

    def _hold(self, ids: Array) -> None:
        self.panel.busy("taking hold")
        frame = self.touching.hold(ids)
        self._drop_gizmo()
        self._trace.clear()
        self._start, self._met, self._typical = frame.centre, Goal(np.zeros(3)), 0.0
        held = self.panel.turning  # whether the hand's direction is
        self._gizmo = self.server.scene.add_transform_controls(
            "/hand",
            scale=0.14 * self.span,
            line_width=4.0,
            disable_rotations=not held,
            depth_test=False,
            position=tuple(frame.centre),
        )

        @self._gizmo.on_update
        async def _(event: Any) -> None:  # on the event loop, so in order
            at, wxyz = event.target.position, event.target.wxyz
            turn = Rotation.from_quat(wxyz[[1, 2, 3, 0]]).as_rotvec()
            now = time.perf_counter()
            count, pace = steps(now - self._heard, self.frame_seconds)
            self._heard = now
            self._lead(Goal(at - self._start, turn if held else None, count, pace))

        self._draw(frame)

    def _let_go(self) -> None:
        self._drop_gizmo()
        self._trace.clear()
        self._draw(self.touching.let_go())

    def _drop_gizmo(self) -> None:
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None

    def _clicked(self, event: Any) -> None:
        origin, way = event.ray_origin, event.ray_direction

        def job() -> None:
            surface = self.frame.surface if self.frame is not None else None
            if surface is None:
                return
            at = hit(origin, way, surface, self.touching.triangles)
            if at is None:  # a twig is thinner than a click
                at = beside(origin, way, surface, AIM)
            if at is not None:
                self._hold(self.touching.patch(at, surface, self.panel.patch))

        self.do(job)

    def _draw(self, frame: Frame) -> None:
        """Send a frame: the shape at once, words, trace and colours five times a second."""
        self.frame = frame
        newtons, held = float(np.linalg.norm(frame.force)), len(self.touching.ids) > 0
        with self.server.atomic():
            if self.skin.move(frame.surface):
                self.skin.colour_by(self.panel.colour, self)
            self._arrow.visible = self._label.visible = held and newtons > 0
            self._dots.visible = held
            if held:
                on = self.touching.mesh.surface_vertices
                rows = np.searchsorted(on, self.touching.ids)
                self._dots.points = frame.surface[rows]
                way = frame.force / max(newtons, 1e-300)
                tip = frame.centre + way * self._long(newtons, frame.travel)
                self._arrow.points = np.array([[frame.centre, tip]])
                self._label.position = tuple(tip)
        if held and frame.exact:
            self._trace.append((1e3 * frame.travel, newtons))
        self._told = False
        if time.perf_counter() - self._spoke > SLOW:
            self._tell(None)

    def _rest_a_moment(self) -> None:
        """When no job waits, draw in full, and say how far it turned, which costs more."""
        with self.server.atomic():
            if self.skin.rest():
                self.skin.colour_by(self.panel.colour, self)
        if not self._told:
            self._tell(self.touching.max_rotation() if len(self.touching.ids) else None)
            self._told = True

    def _tell(self, rotation: float | None) -> None:
        assert self.frame is not None
        self.skin.colour_by(self.panel.colour, self)
        self._label.text = f"{plain(float(np.linalg.norm(self.frame.force)))} N"
        self.panel.tell(self.frame, self._trace, self.frame_seconds, rotation)
        self._spoke = time.perf_counter()

    def _long(self, newtons: float, travel: float) -> float:
        """Return the arrow's length [m], of the force that 2 % of the size takes 0.15."""
        if self._typical == 0.0 and travel > 0:  # of the first frame in which it moved
            self._typical = 0.02 * self.span * newtons / travel
        return 0.3 * self.span * newtons / (newtons + self._typical + 1e-300)
