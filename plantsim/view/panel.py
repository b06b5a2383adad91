"""The viewer's controls: what a page shows beside the plant, and what its knobs do."""

import itertools
import logging
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plantsim.elastic.equilibrium import LINEAR_LIMIT
from plantsim.estimation.estimate import estimate
from plantsim.estimation.files import write_observations
from plantsim.estimation.parameters import per_limb
from plantsim.mesh.files import FORMATS, read_mesh
from plantsim.mesh.limbs import mean_by_region
from plantsim.plant.parameters import species_names
from plantsim.view.plants import potted
from plantsim.view.style import plain
from plantsim.view.touching import KINEMATICS, Burden, Frame, Touching

if TYPE_CHECKING:
    from plantsim.view.app import Viewer

COLOURS = ("plain", "limb", "stress", "stiffness", "estimate", "uncertainty")
HELP = """Click a limb to take hold of it,  
then drag the arrows that appear there.  
Turn the view with the left mouse button,  
shift it with the right, zoom by the wheel."""  # as many lines as words in a drag
REST = "\n".join(["&nbsp;  "] * 3)  # else what stands below would jump
LONGEST = 600.0  # [s] that meshing another plant may take
NOTHING = [(0.0, np.nan), (1.0, np.nan)]  # a trace before there is one: axes alone
POINTS = 400  # of the trace on the page
log = logging.getLogger(__name__)
SPREAD = 0.35  # of the hidden stiffness, one standard deviation of its logarithm


class Panel:
    """Folders of controls; `tell` says how things stand."""

    def __init__(self, server: Any, viewer: "Viewer") -> None:
        """Make the controls; they act on the viewer."""
        self._viewer, self._server = viewer, server
        gui = server.gui
        self._title = gui.add_markdown("")
        self._words = gui.add_markdown(HELP)
        self._touch_folder(gui)
        self._plant_folder(gui)
        self._learn_folder(gui)
        self._other_folder(gui)

    # what the viewer asks

    @property
    def patch(self) -> int:
        """How many vertices a hand takes."""
        return int(self._patch.value)

    @property
    def turning(self) -> bool:
        """Whether the hand holds the direction of its patch, and can turn it."""
        return bool(self._turn.value)

    @property
    def colour(self) -> str:
        """By what the plant is coloured."""
        return str(self._colour.value)

    # what the viewer tells

    def busy(self, what: str) -> None:
        """Say what takes a moment."""
        self._words.content = f"*{what} ...*  \n{REST}"

    def complain(self, why: str) -> None:
        """Tell every open page what went wrong."""
        try:
            self._words.content = f"**{why}**"
            for client in list(self._server.get_clients().values()):
                client.add_notification("plantsim", why, color="red", auto_close_seconds=12)
        except Exception:  # a page that has just closed; whoever complains goes on
            log.exception("could not tell: %s", why)

    def new_plant(self) -> None:
        """Describe the plant that is shown now."""
        viewer = self._viewer
        model, mesh = viewer.touching.model, viewer.touching.mesh
        self._title.content = (
            f"**{viewer.name}**, {len(mesh.region_names)} limbs, {len(mesh.tets):,} tets, "
            f"{3 * (len(mesh.points) - len(model.fixed_ids)):,} unknowns"
        )
        self._words.content = HELP
        self._kinematics.options = KINEMATICS
        self._kinematics.value, self._hidden.value = model.kinematics, False
        self._stiff.value, self._gravity.value, self._fruit.value = 0.0, 0.0, 0.0
        self._fruit.max = float(f"{max(0.2 * model.mass, 1e-3):.1g}") * 5
        self._fruit.step = self._fruit.max / 100
        self._colour.value = "plain"
        self._count()
        self._result.content = ""

    def tell(
        self,
        frame: Frame,
        trace: list[tuple[float, float]],
        seconds: float,
        rotation: float | None,
    ) -> None:
        """Show force, motion, frame rate and trace, and the largest rotation, if known."""
        held = len(self._viewer.touching.ids)
        if held:
            f = frame.force
            total, shift = plain(float(np.linalg.norm(f))), plain(1e3 * frame.travel)
            about = "" if frame.exact else "about "
            rate = f"; {1 / seconds:.0f} frames/s at most" if seconds else ""
            turned = "&nbsp;"
            if not frame.exact:
                on = self._viewer.tries > 0 or self._viewer.balancing is not None
                turned = "*solving for balance ...*" if on else "*near balance: move on*"
            elif rotation is not None:
                turned = f"turned {np.degrees(rotation):.2g} degrees"
                if self._viewer.touching.linear and rotation > LINEAR_LIMIT:
                    turned += ": **choose corotational**"
            lines = (
                f"**{about}{total} N** for {shift} mm",
                f"({', '.join(map(plain, f))}) N",
                f"{held} vertices{rate}",
                turned,
            )
            self._words.content = "  \n".join(lines)
        else:
            self._words.content = HELP
        points = np.array(trace[-POINTS:] if len(trace) > 1 else NOTHING)
        points = points[np.argsort(points[:, 0], kind="stable")]
        self._plot.data = (points[:, 0].copy(), points[:, 1].copy())
        self._legend.content = self._viewer.skin.legend
        self._legend.visible = bool(self._viewer.skin.legend)

    # the folders

    def _touch_folder(self, gui: Any) -> None:
        viewer = self._viewer
        with gui.add_folder("Touch"):
            self._patch = gui.add_slider("vertices", 1, 24, 1, 6)
            self._turn = gui.add_checkbox(
                "hold direction",
                False,
                hint="The patch keeps its direction, and can be turned; set it before you "
                "take hold.",
            )
            go = gui.add_button("Let go")
            go.on_click(lambda _: viewer.let_go())
            self._plot = gui.add_uplot(
                tuple(np.transpose(NOTHING)),
                ({"label": "mm"}, {"label": "N", "stroke": "#1b9e4b", "width": 2}),
                scales={"x": {"time": False}},
                axes=({"label": "displacement, mm"}, {"label": "force, N", "size": 74}),
                aspect=1.6,
                padding=(12, 8, 0, 0),
            )

    def _plant_folder(self, gui: Any) -> None:
        viewer = self._viewer
        with gui.add_folder("Plant"):
            self._stiff = gui.add_slider(
                "stiffness, 10^",
                -1.0,
                1.0,
                0.05,
                0.0,
                hint="Young's modulus times 10 to this power.",
            )
            self._gravity = gui.add_slider("gravity, g", 0.0, 2.0, 0.05, 0.0)
            self._fruit = gui.add_slider("fruit, kg", 0.0, 1.0, 0.01, 0.0)
            self._colour = gui.add_dropdown("colour", COLOURS, initial_value="plain")
            self._legend = gui.add_html("", visible=False)
            self._rest = gui.add_checkbox("rest shape", True)
            self._kinematics = gui.add_dropdown("kinematics", ("linear",))
        for knob in (self._stiff, self._gravity, self._fruit):
            knob.on_update(lambda _: self._bear())
        self._colour.on_update(lambda _: viewer.do(self._recolour))

        @self._rest.on_update
        def _(_: Any) -> None:
            viewer.skin.ghostly(bool(self._rest.value))

        @self._kinematics.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # a person, not a new plant
                viewer.do(self._kinematic)

    def _learn_folder(self, gui: Any) -> None:
        viewer = self._viewer
        with gui.add_folder("Learn its stiffness"):
            self._hidden = gui.add_checkbox(
                "hidden stiffness",
                False,
                hint="Every limb gets a modulus of its own, for you to find by touching.",
            )
            self._blur = gui.add_slider("camera noise, mm", 0.0, 5.0, 0.1, 0.0)
            self._shake = gui.add_slider("force noise, N", 0.0, 0.5, 0.01, 0.0)
            keep = gui.add_button("Record this touch")
            self._kept = gui.add_markdown("")
            self._learn = gui.add_button("Estimate")
            self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
            self._result = gui.add_markdown("")
            down = gui.add_button("Download the touches")
        keep.on_click(lambda _: viewer.do(self._keep))
        self._learn.on_click(lambda _: viewer.do(self._estimate))
        down.on_click(lambda event: viewer.do(lambda: self._download(event.client)))

        @self._hidden.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                viewer.do(self._hide)

    def _other_folder(self, gui: Any) -> None:
        viewer = self._viewer
        with gui.add_folder("Another plant", expand_by_default=False):
            kind = gui.add_dropdown(
                "species", tuple(species_names()), initial_value="apple"
            )
            seed = gui.add_number("seed", 7, min=0, step=1)
            limbs = gui.add_slider("limbs at most", 1, 60, 1, 12)
            grow = gui.add_button("Grow")
            file = gui.add_upload_button("Load a mesh (.msh, .vtu, .npz)")

        @grow.on_click
        def _(_: Any) -> None:
            def job() -> None:
                self.busy(f"growing and meshing {kind.value} {int(seed.value)}")
                pot = potted(kind.value, int(seed.value), int(limbs.value), timeout=LONGEST)
                viewer.show(pot.mesh, pot.material, name=pot.name, masses=pot.masses)

            viewer.do(job)

        @file.on_upload
        def _(_: Any) -> None:
            sent = file.value

            def job() -> None:
                self.busy(f"reading {sent.name}")
                suffix = Path(sent.name).suffix.lower()
                known = suffix if suffix in FORMATS else ".unknown"
                with tempfile.TemporaryDirectory() as folder:
                    path = Path(folder) / f"mesh{known}"
                    path.write_bytes(sent.content)
                    mesh = read_mesh(path)
                viewer.show(mesh, name=Path(sent.name).name)

            viewer.do(job)

    # what the knobs do, in the thread that computes

    def _bear(self) -> None:
        burden = Burden(
            float(self._gravity.value),
            float(self._fruit.value),
            10 ** float(self._stiff.value),
        )
        if burden != self._viewer.touching.burden:
            self._viewer.bear(burden)

    def _recolour(self) -> None:
        viewer = self._viewer
        viewer.skin.colour_by(self.colour, viewer)
        self._legend.content = viewer.skin.legend
        self._legend.visible = bool(viewer.skin.legend)
        if self.colour in ("estimate", "uncertainty") and viewer.found is None:
            self.complain("Nothing was estimated yet: record touches, then Estimate.")

    def _kinematic(self) -> None:
        viewer = self._viewer
        old = viewer.touching
        model = replace(old.model, kinematics=self._kinematics.value)
        touching = Touching(model, old.masses)
        self.busy(f"preparing {model.kinematics} kinematics")
        touching.bear(old.burden)
        viewer.touch_instead(touching)

    def _hide(self) -> None:
        """Give every limb a stiffness of its own, or take it back."""
        viewer = self._viewer
        old = viewer.touching
        material = viewer.prior.material
        if self._hidden.value:
            mesh = old.mesh
            random = np.random.default_rng(len(mesh.tets))
            factor = np.exp(random.normal(0, SPREAD, len(mesh.region_names)))
            material = material.with_young(material.young * factor[np.asarray(mesh.region)])
        touching = Touching(old.model.with_material(material), old.masses)
        touching.bear(old.burden)
        viewer.recorded.clear()
        self._count()
        viewer.touch_instead(touching)

    def _keep(self) -> None:
        viewer = self._viewer
        seen = viewer.touching.record(
            displacement_noise=1e-3 * float(self._blur.value),
            force_noise=float(self._shake.value),
            rng=len(viewer.recorded),
        )
        viewer.recorded.append(seen)
        if viewer.touches_file is not None:
            write_observations(viewer.recorded, viewer.touches_file)
        self._count()

    def _count(self) -> None:
        viewer = self._viewer
        where = f" in {viewer.touches_file}" if viewer.touches_file else ""
        self._kept.content = f"{len(viewer.recorded)} touches recorded{where}"

    def _download(self, client: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = write_observations(self._viewer.recorded, Path(folder) / "touches.npz")
            client.send_file_download(path.name, path.read_bytes(), save_immediately=True)

    def _estimate(self) -> None:
        """Fit the limbs' moduli in a thread of its own, so that dragging goes on."""
        viewer, seen = self._viewer, list(self._viewer.recorded)
        self._learn.disabled, self._bar.visible = True, True
        prior = viewer.prior
        began = time.perf_counter()
        steps = itertools.count(1)

        def step(_: object) -> None:
            seconds = time.perf_counter() - began
            self._result.content = f"*step {next(steps)}, {seconds:.0f} s ...*"

        def run() -> None:
            self._result.content = f"*fitting {len(seen)} touches ...*"
            try:
                found = fitted(prior, seen, step)
            except Exception as why:
                self.complain(f"{why}")
            else:
                seconds = time.perf_counter() - began
                viewer.do(lambda: self._learnt(found, prior, seconds))
            finally:
                self._learn.disabled, self._bar.visible = False, False

        threading.Thread(target=run, name="plantsim estimate", daemon=True).start()

    def _learnt(self, found: Any, prior: Any, seconds: float) -> None:
        viewer = self._viewer
        if prior is not viewer.prior:
            return  # another plant by now
        viewer.found = found
        mesh = viewer.touching.mesh
        young = viewer.touching.model.material.young
        truth = mean_by_region(mesh, young, mesh.volumes)
        factor = viewer.touching.burden.stiffness
        lines = ["| limb | found, GPa | true, GPa |", "|---|---|---|"]
        lines += [
            f"| {name} | {e / 1e9:.3g} | {factor * truth[name] / 1e9:.3g} |"
            for name, e in found.young().items()
        ]
        self._result.content = "\n".join([f"{seconds:.1f} s", "", *lines])
        self._colour.value = "estimate"
        self._recolour()


def fitted(prior: Any, seen: list[Any], step: Callable[[Any], None]) -> Any:
    """Return the estimate of the limbs' moduli from recorded touches.

    Touches without noise bear the balance of every vertex; others go by the default method,
    which calls `step` at each step, if it walks in steps.
    """
    exact = all(s.displacement_noise == s.force_noise == 0 for s in seen)
    if exact:
        return estimate(
            prior, seen, parameters=per_limb(), method="force-balance", rows="balance"
        )
    return estimate(prior, seen, parameters=per_limb(), progress=step)
