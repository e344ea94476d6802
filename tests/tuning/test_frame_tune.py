"""Tuning of the whole frame: padding, gradients, timing, and a small run from the search to its files."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import process_time, sleep
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from extras import need

from hyjax import InputError, tune
from hyjax.configuration import Configuration, LightOptions, Measured, ShadowOptions
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.light.color import to_display
from hyjax.scene.relighter import Relighter, refined_picture
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.tuning.bench import FrameBench
from hyjax.tuning.clock import FrameClock, FrameTime, Rounds, quiet_rounds, rounds_of, slowest_setup
from hyjax.tuning.evaluation import Judge, padded
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.proposal import frame_objective, relaxed_choices, relaxed_of
from hyjax.tuning.refinement import numbers_of, refine_numbers, settled, with_numbers
from hyjax.tuning.request import Budget
from hyjax.tuning.scene import Target, TuningScene, open_tuning_scene, spread_cases
from hyjax.tuning.settings import FrameOptions, OtherDevice, TuneScene, TuneSettings
from hyjax.tuning.space import Space
from hyjax.tuning.stage import FrameStage, check_reachable

need("tune")


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="module")
def scene(room: RoomCapture) -> TuningScene:
    rough, accurate = (Scene.open(SceneSettings(mesh=mesh), capture=room) for mesh in ("scan", "true"))
    return TuningScene("room", rough, accurate)


@pytest.fixture(scope="module")
def judge(scene: TuningScene) -> Judge:
    return Judge([scene], PictureLoss())


def light_options(**options: object) -> Configuration:
    return dataclasses.replace(Configuration(), light=LightOptions(**options))  # type: ignore[arg-type]


CONFIGURATIONS = {
    "default": Configuration(),
    "half the size": dataclasses.replace(Configuration(), scale=2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_lights_that_give_nothing_change_no_picture(scene: TuningScene, name: str) -> None:
    relighter = scene.relighter("two-colors", CONFIGURATIONS[name])
    frame = scene.scene.frame(2)
    lit = relighter.lit(frame)
    more = padded(lit, 4)
    assert more.shaded.illuminance.shape[-1] == 4
    expected, picture = (refined_picture(each, relighter.configuration) for each in (lit, more))
    np.testing.assert_allclose(picture, expected, atol=2e-5)
    np.testing.assert_allclose(relighter.picture(frame), expected, atol=1e-6)


@pytest.mark.slow
def test_the_best_is_not_worse_than_the_start(judge: Judge) -> None:
    cases, told = [(0, "two-colors", 1), (0, "golden-hour", 4)], []
    poor = dataclasses.replace(Configuration(), schedule=Schedule.preset("hyjax", kappa=0.4))
    better = refine_numbers(poor, judge, cases, iterations=6, report=lambda _, loss: told.append(loss))
    assert told[0] == pytest.approx(1.0, abs=1e-4) and min(told) < 0.99
    before, after = (np.mean([row["loss"] for row in judge.scores(each, cases)]) for each in (poor, better))
    assert after < before
    assert float(np.asarray(better.schedule.levels[0].kappa)) < 0.4
    same = refine_numbers(poor, judge, cases[:1], iterations=1, held=("photo_exponent", "kappa"))
    assert same.light.photo_exponent == poor.light.photo_exponent and same.value("kappa") == poor.value("kappa")
    assert same.value("lam") != poor.value("lam")


@pytest.mark.slow
def test_the_gradient_is_that_of_finite_differences(judge: Judge) -> None:
    """Of the loss through the cascades, in the logarithm of each number."""
    scene, configuration = judge.scenes[0], light_options(photo_light="kept")
    relighter, frame = scene.relighter("two-colors", configuration), scene.scene.frame(1)
    lit, target = relighter.lit(frame), scene.target("two-colors", 1)
    numbers = {name: jnp.log(value) for name, value in numbers_of(configuration, levels=False).items()}
    with jax.enable_x64(True):

        def double(tree: object) -> object:
            return jax.tree.map(
                lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x,
                jax.tree.map(jnp.asarray, tree),
            )

        own = double(lit)

        @jax.jit
        def loss(logs: dict[str, jax.Array]) -> jax.Array:
            changed = with_numbers(configuration, {name: jnp.exp(value) for name, value in logs.items()})
            return judge.loss.value(refined_picture(own, changed), jnp.ones(3), target.picture, target.valid)

        logs = double(numbers)
        slope = jax.grad(loss)(logs)
        for name in logs:
            up, down = (loss(logs | {name: logs[name] + step}) for step in (1e-4, -1e-4))
            expected = float(up - down) / 2e-4
            assert float(slope[name]) == pytest.approx(expected, rel=2e-3, abs=1e-7), name


def test_numbers_go_in_and_out() -> None:
    for levels in (True, False):
        numbers = numbers_of(Configuration(), levels=levels)
        again = numbers_of(settled(Configuration(), numbers), levels=levels)
        for name, value in numbers.items():
            np.testing.assert_allclose(again[name], value, rtol=1e-4)
    assert "fidelity" not in numbers_of(Configuration.paper(), levels=True)
    assert "photo_exponent" not in numbers_of(Configuration.paper(), levels=True)


def test_losses_know_what_is_fitted() -> None:
    rng = np.random.default_rng(0)
    picture = rng.uniform(0.1, 0.8, (48, 64, 3)).astype(np.float32)
    linear = ((picture + 0.055) / 1.055) ** 2.4  # nearly
    valid = np.ones((48, 64), bool)
    fitted, plain = (PictureLoss().scores(0.5 * linear, Target(picture, valid, own)) for own in (True, False))
    assert fitted["loss"] < plain["loss"] - 0.1 and fitted["psnr_raw"] == pytest.approx(plain["psnr"], abs=1e-3)
    assert fitted["psnr"] > fitted["psnr_raw"] + 10


def test_the_loss_sees_brightness_that_gains_hide() -> None:
    picture, valid = np.full((48, 64, 3), 0.5, np.float32), np.ones((48, 64), bool)
    linear, target = np.full_like(picture, 0.214), Target(picture, valid, True)
    alone = PictureLoss(brightness=0.0)
    assert alone.scores(0.5 * linear, target)["loss"] < 0.01
    bright, dim = (PictureLoss().scores(gain * linear, target)["loss"] for gain in (1.0, 0.5))
    assert bright < 0.01 and dim > 0.05
    value = PictureLoss().value(0.5 * jnp.asarray(linear), jnp.full(3, 2.0), jnp.asarray(picture), valid)
    assert float(value) == pytest.approx(dim, rel=0.05)


def test_batches_have_many_scenes_and_setups() -> None:
    cases = spread_cases([[0, 4, 8], [1, 5, 9], [2, 6, 10]], ["a", "b", "c"], seed=3)
    assert len(cases) == len(set(cases)) == 27
    for start in range(0, 27, 3):
        assert len({place for place, _, _ in cases[start : start + 3]}) == 3
        assert len({lights for _, lights, _ in cases[start : start + 3]}) == 3
    assert cases == spread_cases([[0, 4, 8], [1, 5, 9], [2, 6, 10]], ["a", "b", "c"], seed=3)


@pytest.mark.slow
def test_frames_are_timed_in_turns(scene: TuningScene) -> None:
    clock = FrameClock(scene, "two-colors")
    small = dataclasses.replace(Configuration(), scale=4, shadows=ShadowOptions(views=4))
    own, fast = clock.times([Configuration(), small], 8)
    assert own.default == fast.default > 0 and own.ratio > 0
    assert 0 < fast.median <= fast.p95
    assert own.median == own.default and own.ratio == 1.0, "the default is timed once"
    assert slowest_setup(scene, ["two-colors", "evening-lamps", "golden-hour"]) == "evening-lamps", "four lights"


def test_budgets_are_judged_by_quiet_rounds_and_by_the_ratio() -> None:
    rng = np.random.default_rng(0)
    default, own = rng.uniform(20.0, 21.0, 100), rng.uniform(10.0, 10.5, 100)
    busy = np.arange(100) % 3 == 0
    default[busy], own[busy] = 3 * default[busy], 4 * own[busy]
    quiet = quiet_rounds([own, default])
    assert quiet.sum() == 50 and not np.any(quiet & busy)
    time = FrameTime.of_rounds(Rounds(own, own), Rounds(default, default), quiet)
    assert time.p95 > 38 and time.disturbed and time.default_p95 > 55
    assert time.quiet_p95 < 10.6 and time.judged == pytest.approx(max(time.quiet_p95, time.by_default))
    slow = dataclasses.replace(time, ratio=0.9)
    assert slow.judged == pytest.approx(0.9 * time.default_quiet_p95), "the ratio says that it takes longer"
    calm = FrameTime.of_rounds(*(Rounds(x[~busy], x[~busy]) for x in (own, default)), np.ones(66, bool))
    assert not calm.disturbed and calm.judged <= calm.p95
    assert FrameTime(9.0, 10.0, 20.0, 0.45).judged == 10.0 and not FrameTime(9.0, 10.0, 20.0, 0.45).disturbed


def test_waiting_for_a_processor_counts_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def wait() -> None:
        end = process_time() + 0.004
        while process_time() < end:
            pass
        sleep(0.02)

    (own,) = rounds_of({"a": wait}, 10).values()
    assert len(own.wall) == 10 and np.all(own.wall > 23) and np.median(own.undisturbed) < 10
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    (own,) = rounds_of({"a": wait}, 2).values()
    assert np.all(own.undisturbed > 23), "a processor that waits for a device"


def test_a_disturbed_clock_refuses_no_budget(caplog: pytest.LogCaptureFixture) -> None:
    """Where the smallest configuration seems slower than the default, other work is timed."""
    space, base = Space.of(truth=True), FrameTime(20.0, 22.0, 20.0, 1.0)

    class Busy:
        def times(self, configurations: Sequence[Configuration], *_: object, **__: object) -> list[FrameTime]:
            return [FrameTime(9.0, 40.0, 20.0, 0.45) for _ in configurations]

    check_reachable([Budget("60 fps", 16.7)], base, space, Busy())
    assert "other work disturbs the clock" in caplog.text
    calm = type("Calm", (Busy,), {"times": lambda _, c, *__, **___: [FrameTime(9.0, 17.0, 20.0, 0.45) for _ in c]})
    with pytest.raises(InputError, match="out of reach"):
        check_reachable([Budget("60 fps", 16.7)], base, space, calm())


@pytest.mark.slow
def test_whole_steps_relaxed_are_the_frame_itself(judge: Judge) -> None:
    """The relaxed cascade in the place of the frame's own gives its picture's loss, and levels may be proposed."""
    space, cases = Space.of(truth=False), [(0, "two-colors", 1)]
    choices = space.complete({"cascade": "8:2", "scale": 2})
    configuration = space.configuration(choices)
    objective = frame_objective(configuration, judge, cases, (16, 8, 4))
    point = relaxed_of(configuration.schedule, (16, 8, 4))
    (row,) = judge.scores(configuration, cases)
    assert objective(point) == pytest.approx(row["loss"], rel=1e-3)
    price = {factor: 0.01 * (4 / factor) ** 2 for factor in (16, 8, 4, 2)}
    better = relaxed_choices(choices, space, judge, cases, price=price, room=0.2)
    if better != choices:
        (after,) = judge.scores(space.configuration(better), cases)
        assert after["loss"] < row["loss"]
    assert relaxed_choices(choices, space, judge, cases, price=price, room=-9.0) == choices, "no room at all"
    bilinear = space.complete({"upsampling": "bilinear"})
    assert relaxed_choices(bilinear, space, judge, cases, price=price, room=0.2) == bilinear, "not in this form"


# ---- a run ----


@pytest.fixture(scope="module")
def options(tmp_path_factory: pytest.TempPathFactory) -> TuneSettings:
    return TuneSettings(
        TuneScene(size=None),
        frame=FrameOptions(trials=4),
        budget_ms=(1e4,),
        lights="two-colors",
        frames="0,2",
        holdout="5",
        extra=False,
        out=tmp_path_factory.mktemp("tuned") / "out",
        quiet=True,
    )


def moved_numbers(configuration: Configuration, *_: object, levels: bool, **__: object) -> Configuration:
    numbers = numbers_of(configuration, levels=levels)
    return settled(configuration, numbers | {"kappa": 0.9 * numbers["kappa"]})


def steady_times(
    _: FrameClock, configurations: Sequence[Configuration], repeats: int, *, most_seconds: float | None = None
) -> list[FrameTime]:
    """A clock on which only the size counts."""
    return [FrameTime(9.0 / c.scale, 10.0 / c.scale, 9.0, 1.0 / c.scale) for c in configurations]


@pytest.fixture(scope="module")
def finished(options: TuneSettings, room: RoomCapture) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:  # tests of their own look at gradients and clock
        patch.setattr("hyjax.tuning.evaluator.relaxed_choices", lambda choices, *_, **__: choices)
        for module in ("evaluator", "stage"):
            patch.setattr(f"hyjax.tuning.{module}.refine_numbers", moved_numbers)
        patch.setattr("hyjax.tuning.stage.PRESETS", ("fast",))
        patch.setattr(FrameClock, "times", steady_times)
        tuned = tune(settings=options, capture=room)
    assert tuned.best[0].tuning["relative"] <= 1.0 and tuned.best[0].held_out is not None
    assert tuned.record["kept"] == ["10000 ms"] and tuned.configuration.measured is not None
    assert len(tuned.trials) >= 3
    assert options.out is not None
    yield options.out


@pytest.mark.slow
def test_a_run_leaves_what_others_take(finished: Path, options: TuneSettings) -> None:
    names = {path.name for path in finished.iterdir()}
    assert {
        "configuration.json",
        "pareto.csv",
        "pareto.png",
        "contact_sheet.png",
        "report.html",
        "study.log",
    } <= names
    own = Configuration.open(str(finished / "configuration.json"))
    assert isinstance(own.measured, Measured) and own.measured.size == (120, 160)
    content = json.loads((finished / "configuration.json").read_text())
    assert content["format"] == 1 and content["mode"] == "linear"


@pytest.mark.slow
def test_a_finished_run_is_not_overwritten_and_goes_on(
    finished: Path, options: TuneSettings, room: RoomCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="--resume"):
        tune(settings=options, capture=room)
    with pytest.raises(InputError, match="cannot resume"):
        tune(settings=dataclasses.replace(options, resume=True, frames="1"), capture=room)
    asked: list[object] = []
    for name in ("refine_numbers", "relaxed_choices"):
        monkeypatch.setattr(f"hyjax.tuning.evaluator.{name}", lambda *a, **k: asked.append(a))
    monkeypatch.setattr("hyjax.tuning.stage.PRESETS", ("fast",))
    monkeypatch.setattr(FrameClock, "times", steady_times)
    again = tune(settings=dataclasses.replace(options, resume=True), capture=room)
    assert not asked and len(again.trials) >= 3


@pytest.mark.slow
def test_a_budget_out_of_reach_names_the_fastest(
    options: TuneSettings, room: RoomCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FrameClock, "times", steady_times)
    settings = dataclasses.replace(options, budget_ms=(0.01,), out=None)
    with pytest.raises(InputError, match=r"^budget 0\.01 ms: out of reach .* the fastest that was found takes"):
        tune(settings=settings, capture=room)


class Remembered:
    """A study that keeps nothing."""

    def timed(self, name: str) -> str:
        return name

    def remember(self, name: str, compute: Callable[[], Any]) -> Any:
        return compute()


@pytest.mark.parametrize(("milliseconds", "usual"), [(20.0, True), (10.5, True), (6.0, False)])
def test_what_no_true_picture_judges_is_a_quick_presets_for_less_than_the_defaults_time(
    scene: TuningScene, milliseconds: float, usual: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FrameClock, "times", steady_times)
    settings = TuneSettings(budget_ms=(milliseconds, 1.0), quiet=True)
    bench = FrameBench([scene], [(0, "two-colors", 0)], [], "two-colors")
    stage = FrameStage(bench, settings)
    stage.base_time(Remembered())  # type: ignore[arg-type]
    balanced, own = Configuration.preset("balanced"), stage.space.configuration(stage.space.default)
    assert Configuration().light != balanced.light and balanced.light.edges
    assert own.light == (Configuration() if usual else balanced).light
    assert own.schedule.levels == Configuration().schedule.levels, "what is searched starts from the default"
    (again,) = stage.starts([0.5])[1:2]
    assert stage.space.configuration(again).light == (own.light if usual else balanced.light)
    assert stage.record()["not searched, as in"] == ("default" if usual else "balanced")

    def times_of_light(_: FrameClock, several: Sequence[Configuration], repeats: int) -> list[FrameTime]:
        """A step at level 4 costs a hundredth of the default's time; another light than its own, a fifth less."""
        ratios = [
            (0.8 if c.light != Configuration().light else 1.0)
            + 0.01 * (c.schedule.levels[-1].steps - Configuration().schedule.levels[-1].steps)
            for c in several
        ]
        return [FrameTime(9.0 * ratio, 10.0 * ratio, 9.0, ratio) for ratio in ratios]

    monkeypatch.setattr(FrameClock, "times", times_of_light)
    evaluator = stage.evaluator(stage.space, Remembered(), lambda: False)  # type: ignore[arg-type]
    assert evaluator.time(stage.space.default) == (1.0 if usual else 0.8)
    assert evaluator._price()[4] == pytest.approx(0.01), "of a step, whatever the light costs"


@pytest.mark.parametrize(
    ("change", "choices"),
    [({"renderer": "tour"}, ()), ({"renderer": "page"}, ()), ({}, ("light_edges=false", "scale=2")), ({}, ())],
)
def test_whatever_may_be_the_answer_is_followed(scene: TuningScene, change: dict, choices: tuple[str, ...]) -> None:
    """The default and the presets too, with what is held and as the renderer has them."""
    settings = TuneSettings(budget_ms=(9.0,), quiet=True, frame=FrameOptions(choices=choices), **change).check()
    stage = FrameStage(FrameBench([scene], [(0, "two-colors", 0)], [], "two-colors"), settings)
    base, *others = stage.references()
    assert base is stage.base and all(map(stage.is_followed, others))
    plain = not (change or choices)
    assert [c.name for c in others] == ["quality", "balanced", "fast"] if plain else len(others) == 4
    for own in others:
        assert all(own.value(name) == value for name, value in settings.frame.held.items())


@pytest.mark.parametrize("lights", ["golden-hour", "evening-lamps"])
def test_targets_are_what_the_accurate_surface_makes_of_a_frame_unrefined(scene: TuningScene, lights: str) -> None:
    plain = Configuration().with_choices({"sampling": 1, "photo_light": "kept"})
    assert scene.accurate is not None
    relit = Relighter(scene.accurate, scene.setup(lights), plain, occluders="surface", whole=True).relit(2)
    target = scene.target(lights, 2)
    assert target.valid.mean() > 0.5
    difference = np.abs(target.picture - np.asarray(to_display(relit.unrefined)))[target.valid]
    assert difference.max() < 1e-5


def test_a_search_on_a_capture_takes_five_minutes_unless_more_is_asked_for() -> None:
    seconds = {
        TuneSettings(): 300.0,
        TuneSettings(time_limit=20.0): 20.0,
        TuneSettings(frame=FrameOptions(trials=100)): None,
        TuneSettings(frame=FrameOptions(trials=100), time_limit=20.0): 20.0,
        TuneSettings(frame=FrameOptions(rooms=("builtin-0",))): None,
        TuneSettings(frame=FrameOptions(paper_form=True)): None,
    }
    assert {settings: settings.limit_seconds for settings in seconds} == seconds


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame": FrameOptions(rooms=("builtin",))}, "rooms: no room 'builtin'"),
        ({"frame": FrameOptions(rooms=("random-5-6-dayy",))}, "did you mean"),
        ({"frame": FrameOptions(rooms=("builtin-0",), holdout_rooms=("builtin-0",))}, "tuned on as well"),
        ({"frame": FrameOptions(holdout_rooms=("builtin-0",))}, "go with --rooms"),
        ({"frame": FrameOptions(trials=0)}, r"trials: must lie in 4\.\."),
        ({"frame": FrameOptions(lpips=-1.0)}, "lpips"),
        ({"frame": FrameOptions(choices=("bounces",))}, "choices: 'bounces' has no value"),
        ({"frame": FrameOptions(choices=("light_edge=true",))}, "did you mean"),
        ({"frame": FrameOptions(choices=("cascade=8:4",))}, "choices: cascade cannot be held"),
        ({"frame": FrameOptions(choices=("scale=2", "scale=3"))}, "choices: scale is given twice"),
        ({"frame": FrameOptions(choices=("guide=nothere",))}, "guide: nothere"),
        ({"frame": FrameOptions(choices=("sampling=4",))}, "choices: sampling cannot be held"),
        ({"frame": FrameOptions(choices=("mode=paper",))}, "choices: mode cannot be held"),
        ({"frame": FrameOptions(choices=("scale=2",)), "renderer": "page"}, "choices: scale 2 is not for exported"),
        ({"frame": FrameOptions(choices=("scale=2",)), "stage": "cascade"}, "choices: are of the whole frame"),
        ({"lights": "two-colors,nowhere"}, "nowhere"),
        ({"stage": "cascade", "lights": "two-colors,golden-hour"}, "one set-up"),
        ({"stage": "frame", "target_device": OtherDevice(device=True)}, "stage: a page times the diffusion alone"),
    ],
)
def test_bad_settings_are_told(options: TuneSettings, change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        dataclasses.replace(options, **change).check()


def test_scenes_without_a_better_surface_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        open_tuning_scene(str(tmp_path))
