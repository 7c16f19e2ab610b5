"""The loop with a task of a few lines: a curve that is fitted, stopped at any step, and resumed."""

import subprocess
import sys

import pytest

torch = pytest.importorskip("torch")

from lambent.errors import FileError, OptionError
from lambent.training.loop import train
from lambent.training.schedule import Schedule
from lambent.training.task import Task

STEPS = 12


class Curve(Task):
    """Fit y = sin(3 x) by a small network with dropout, harder and harder examples first."""

    def __init__(self):
        self.hardest = torch.zeros(1)
        self.closed = False

    def network(self):
        layers = torch.nn.Linear(1, 16), torch.nn.Tanh(), torch.nn.Dropout(0.1)
        return torch.nn.Sequential(*layers, torch.nn.Linear(16, 1))

    def loss(self, model, step):
        x = 2 * torch.rand(64, 1, device=self.device) - 1  # PyTorch's numbers are resumed, too
        x = torch.cat([x, self.hardest[None].to(self.device)])
        error = (model(x) - torch.sin(3 * x)).square()
        self.hardest = x[error.argmax()].detach().cpu()
        return error.mean(), {"largest": error.max()}

    def score(self, model):
        x = torch.linspace(-1, 1, 101, device=self.device)[:, None]
        return {"score": float((model(x) - torch.sin(3 * x)).square().mean())}, {}

    def state(self):
        return {"hardest": self.hardest}

    def resume(self, state):
        self.hardest = state["hardest"]

    def close(self):
        self.closed = True


def schedule(steps=STEPS, **more):
    return Schedule(steps=steps, warmup=3, rate=1e-2, check_every=5, **more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return train(schedule(), Curve(), tmp_path_factory.mktemp("whole"), "cpu")


def state_of(run):
    return torch.load(run.state, weights_only=True)


@pytest.mark.parametrize("stop", range(1, STEPS))
def test_a_run_stopped_at_any_step_goes_on_bit_for_bit(whole, tmp_path, stop):
    train(schedule(), Curve(), tmp_path, "cpu", steps=stop)
    again = train(schedule(), Curve(), tmp_path, "cpu")
    one, two = state_of(whole), state_of(again)
    for what in ("model", "mean", "task", "random"):
        assert all(torch.equal(one[what][k], two[what][k]) for k in one[what]), what
    for moments, others in zip(
        one["optimiser"]["state"].values(), two["optimiser"]["state"].values(), strict=True
    ):
        assert all(torch.equal(moments[k], others[k]) for k in moments)
    assert one["step"] == two["step"] == STEPS
    assert whole.checks() == again.checks()
    assert all(torch.equal(v, again.weights()[k]) for k, v in whole.weights().items())


def test_an_error_in_a_step_loses_no_step_before_it(whole, tmp_path):
    class Breaks(Curve):
        def loss(self, model, step):
            if step == 7:
                raise KeyboardInterrupt
            return super().loss(model, step)

    with pytest.raises(KeyboardInterrupt):
        train(schedule(), Breaks(), tmp_path, "cpu")
    again = train(schedule(), Curve(), tmp_path, "cpu")
    one, two = state_of(whole)["model"], state_of(again)["model"]
    assert all(torch.equal(one[k], two[k]) for k in one)


def test_the_curve_is_learned(tmp_path):
    run = train(schedule(400, decay=0.9), Curve(), tmp_path, "cpu")
    scores = [line["check"]["score"] for line in run.checks()]
    assert scores[-1] < 0.5 * scores[0]
    assert [line for line in run.lines() if "largest" in line]
    assert torch.load(run.best, weights_only=True)["scores"]["score"] == pytest.approx(
        min(scores), abs=1e-6
    )


def test_weights_to_begin_with_go_through_the_task_once(whole, tmp_path):
    asked = []

    class Scaled(Curve):
        def started(self, weights):
            asked.append(weights)
            return {name: 2 * value for name, value in weights.items()}

    start = whole.weights()
    train(schedule(), Scaled(), tmp_path, "cpu", start=start, steps=0)
    mean = state_of(type(whole)(tmp_path))["mean"]
    assert all(torch.equal(2 * start[k], mean[k]) for k in start)
    train(schedule(), Scaled(), tmp_path, "cpu", start=start, steps=1)
    assert len(asked) == 1  # a run that goes on has weights of its own


def test_settings_are_kept_and_compared(tmp_path):
    settings = {"name": "curve", "noise": 0.1, "note": "one"}
    train(schedule(), Curve(), tmp_path, "cpu", steps=1, settings=settings)
    said = []
    run = train(
        schedule(), Curve(), tmp_path, "cpu", steps=2, settings={**settings, "note": "two"},
        may_differ=("note",), progress=lambda *line: said.append(line),
    )  # fmt: skip
    assert run.recipe() == settings
    assert said == [(1, 1, "training curve, step 2 of 2")]
    with pytest.raises(OptionError, match="noise differ"):
        train(schedule(), Curve(), tmp_path, "cpu", settings={**settings, "noise": 0.2})


def test_a_state_of_an_earlier_version_is_named(tmp_path):
    run = train(schedule(), Curve(), tmp_path, "cpu", steps=1)
    state = state_of(run)
    del state["random"]
    torch.save(state, run.state)
    with pytest.raises(FileError, match="earlier version"):
        train(schedule(), Curve(), tmp_path, "cpu")


def test_the_rate_rises_and_falls():
    it = Schedule(steps=100, warmup=10, last_rate=0.01, rate=2.0)
    rates = [it.rate_at(step) / it.rate for step in range(100)]
    assert rates[0] == pytest.approx(0.1)
    assert max(rates) == pytest.approx(1.0)
    assert rates[10:] == sorted(rates[10:], reverse=True)
    assert rates[-1] == pytest.approx(0.01, abs=2e-3)
    assert it.rate_at(50, 1.0) / it.rate == pytest.approx(0.01)


def test_what_is_learned_with_is_named_without_pytorch():
    code = (
        "import sys, lambent.training.schedule, lambent.training.task, lambent.training.run;"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
