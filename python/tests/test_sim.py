"""The simulator from Python: bits, environments."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tesaki
from tesaki import sim

SWEEPS = Path(__file__).resolve().parents[2] / "docs" / "sweeps" / "development"


def recorded(scenario, seed):
    """Returns the results of ``cargo sim`` when the sweeps were recorded."""
    machines = json.loads((SWEEPS / f"{scenario}.json").read_text())["machines"]
    return next(machine for machine in machines if machine["seed"] == seed)["frames_sha256"]


@pytest.mark.parametrize("scenario", ["hand3-servo", "arm7-elbow"])
def test_a_run_is_bit_for_bit_that_of_cargo_sim(scenario):
    result = sim.run(scenario, 2)
    assert result.frames_sha256 == recorded(scenario, 2)
    assert result.summary["pass"] is True
    name = next(iter(result.tables))
    table = result.table(name)
    assert len(table) > 100 and table.dtype.names[0] == "time_s"


def test_commands_sent_from_python_give_the_same_bits():
    """Every command of the fingertip scenario passes through Python's arrays."""
    steps = sim.Run("hand3-reach", tesaki.robots() / "hand3", 1)
    state = steps.begin()
    kinds = set()
    while state is not None:
        scripted = state["scripted"]
        if scripted is not None:
            kinds.add(scripted[0])
        state = steps.step(*(scripted or ()))
    digest = json.loads(steps.summary())["summary"]["frames_sha256"]
    assert digest == recorded("hand3-reach", 1)
    assert kinds == {"joints", "tips"}


def test_a_thread_may_read_while_another_steps():
    program = """
import threading, tesaki
from tesaki import sim
run = sim.Run("hand3-servo", tesaki.robots() / "hand3", 1)
done = threading.Event()
def read():
    while not done.is_set():
        run.summary()
readers = [threading.Thread(target=read) for _ in range(2)]
for reader in readers:
    reader.start()
run.begin()
for _ in range(1000):
    run.step()
done.set()
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_on_tick_sees_every_period_and_changes_nothing():
    ticks, trials = [], set()

    def look(state):
        ticks.append(state["tick"])
        trials.add(state["trial"])
        assert state["truth"]["position"].shape == state["position"].shape == (9,)
        # The board's values are one period older, and homing has an error of up to 2 mrad.
        period = abs(state["truth"]["velocity"]).max() * sim.PERIOD
        assert abs(state["truth"]["position"] - state["position"]).max() < 0.005 + 1.5 * period

    result = sim.run("hand3-servo", 1, on_tick=look)
    assert result.frames_sha256 == recorded("hand3-servo", 1)
    assert trials == {1, 2, 3, 4} and len(ticks) > 2000


def test_the_environment_keeps_gymnasiums_rules():
    from gymnasium.utils.env_checker import check_env

    # The checker samples actions: goals within the joints' limits.
    env = sim.make("hand3-servo")
    check_env(env, skip_render_check=True)
    first, _ = env.reset(seed=5)
    again, _ = env.reset(seed=5)
    other, _ = env.reset(seed=6)
    assert all(np.array_equal(first[name], again[name], equal_nan=True) for name in first)
    assert any(not np.array_equal(first[name], other[name], equal_nan=True) for name in first)


def test_an_episode_of_joints():
    env = sim.make("hand3-servo", trial=2)
    observation, info = env.reset(seed=1)
    assert info["trial"] == 2 and env.action_space.shape == (9,)
    goal = observation["position"] + 0.1
    for _ in range(150):
        observation, reward, terminated, truncated, info = env.step(goal)
        assert not (terminated or truncated) and info["refused"] is None
    assert abs(observation["position"] - goal).max() < 2e-3
    assert abs(info["truth"]["position"] - goal).max() < 5e-3
    assert reward == -abs(info["truth"]["position"] - observation["target"]).mean()
    _, _, _, _, info = env.step(np.full(9, 9.0, np.float32))
    assert info["refused"].startswith("finger1_swing: ") and "limit" in info["refused"], info["refused"]
    with pytest.raises(ValueError, match=r"^action has the shape \(3, 3\), expected \(9,\): a goal for each"):
        env.step(goal.reshape(3, 3))
    for count in (3, 20):
        with pytest.raises(ValueError, match=rf"^action has the shape \({count},\), expected \(9,\): a goal for each"):
            env.step(np.zeros(count))
    while not truncated:
        _, _, terminated, truncated, info = env.step(None)
    assert not terminated and info["fault"] is None
    with pytest.raises(tesaki.SimulationError, match="^the episode is over: reset$"):
        env.step(None)


def test_a_fault_terminates():
    env = sim.make("hand3-reach")
    with pytest.raises(tesaki.SimulationError, match="^no episode has begun: reset$"):
        env.step(None)
    observation, info = env.reset(seed=1)
    assert env.kind == "tips" and env.action_space.shape == (3, 9)
    # A jump of 20 mm is refused: the previous set-point remains.
    leap = observation["target"].copy()
    leap[:, 2] += 0.02
    _, _, terminated, _, info = env.step(leap)
    assert info["refused"] and not terminated
    # Without commands: the command timeout of ten ticks.
    steps = 0
    while not terminated:
        _, _, terminated, truncated, info = env.step(("nothing",))
        steps += 1
        assert steps <= 12 and not truncated
    assert steps >= 9 and "command" in info["fault"], info["fault"]
    with pytest.raises(tesaki.SimulationError, match="^the episode is over: reset$"):
        env.step(None)


def test_random_goals_are_not_refused():
    env = sim.make("hand3-servo")
    limits = tesaki.Robot(tesaki.robots() / "hand3").limits
    assert np.array_equal(env.action_space.low, limits[:, 0]) and np.array_equal(env.action_space.high, limits[:, 1])
    env.action_space.seed(1)
    env.reset(seed=1)
    for _ in range(30):
        _, _, terminated, _, info = env.step(env.action_space.sample())
        assert not terminated and info["refused"] is None
    points = sim.make("hand3-servo", kind="points").action_space
    assert np.array_equal(points.low[:, 0], limits[:, 0]) and np.isinf(points.high[:, 1:]).all()
    assert np.isinf(sim.make("arm7-elbow").action_space.high).all()


def test_refused_commands_do_not_feed_the_watchdog():
    env = sim.make("hand3-servo")
    env.reset(seed=1)
    steps, terminated = 0, False
    while not terminated:
        _, _, terminated, _, info = env.step(np.full(9, 9.0, np.float32))
        assert info["refused"]
        steps += 1
        assert steps <= 12
    assert steps >= 9 and "command" in info["fault"], info["fault"]


def test_an_arm_is_led():
    env = sim.make("arm7-elbow")
    observation, info = env.reset(seed=1)
    report = info["report"]["Impedance"]
    target = np.zeros(22, np.float32)
    target[:3], target[3:7], target[19] = report["position"], report["rotation"], report["elbow"]
    target[2] += 0.02
    start = info["truth"]["tip_position"][0].copy()
    for _ in range(150):
        observation, _, terminated, truncated, info = env.step(target)
        assert not (terminated or truncated) and info["refused"] is None
    np.testing.assert_allclose(info["truth"]["tip_position"][0] - start, [0, 0, 0.02], atol=2e-3)


def test_an_object_is_moved():
    env = sim.make("hand3-turn")
    observation, info = env.reset(seed=1)
    assert info["report"]["Grasping"]["phase"] == "Hold" and env.action_space.shape == (7,)
    before = info["truth"]["object_position"].copy()
    assert info["truth"]["contact_force"].shape == (3, 3)
    # Up by 5 mm against gravity, which the hand's model has, within a second.
    gravity = np.array([-6.9367, 0.0, -6.9367])
    up = -0.005 * gravity / np.linalg.norm(gravity)
    _, _, _, _, info = env.step([*up, 0.0, 0.0, 0.0, 1.0])
    assert info["refused"] is None
    for _ in range(150):
        # Not the scenario's own command.
        _, _, terminated, truncated, info = env.step(("nothing",))
        assert not (terminated or truncated)
    moved = info["truth"]["object_position"] - before
    np.testing.assert_allclose(moved, up, atol=1.5e-3)


KINDS = {
    "hand3-servo": "joints", "hand3-first-motion": "joints", "hand3-paper-motion": "joints", "hand3-reach": "tips",
    "knob-grasp": "hand",
}
STEPPED = [scenario["name"] for scenario in sim.scenarios() if scenario["name"] not in ("knob-find", "hand5-calibrate")]


@pytest.mark.parametrize("scenario", STEPPED)
def test_every_scenario_that_commands_a_board_is_an_environment(scenario):
    env = sim.make(scenario)
    expected = {"hand3": "object", "arm7-": "tool", "hand5": "fingertips"}.get(scenario[:5])
    assert env.kind == KINDS.get(scenario, expected)
    observation, info = env.reset(seed=1)
    for _ in range(3):
        assert observation in env.observation_space
        assert info["trial"] == 1 and info["fault"] is None and info["truth"] is not None
        observation, reward, terminated, truncated, info = env.step(None)
        assert np.isfinite(reward) and not (terminated or truncated)
    env.close()


def test_what_is_wrong_is_said():
    with pytest.raises(ValueError, match="^no scenario \"hand4\"; the scenarios are: hand3-servo, "):
        sim.run("hand4")
    with pytest.raises(ValueError, match="^kind is 'toes': expected one of joints, "):
        sim.make("hand3-servo", kind="toes")
    with pytest.raises(ValueError, match="^trial is 9, but hand3-servo has 4$"):
        sim.make("hand3-servo", trial=9)
    with pytest.raises(tesaki.SimulationError, match="^hand5-calibrate enables no board that could be commanded: run it$"):
        sim.make("hand5-calibrate")
    with pytest.raises(tesaki.FileError, match="a robot folder holds"):
        sim.run("hand3-servo", robot="/nowhere")
