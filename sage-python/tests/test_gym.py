"""Environments of Gymnasium: its checks and those of Stable-Baselines3, our own of the vector environment, and what users get wrong."""

import contextlib
import copy
import gc
import multiprocessing
import os
import pathlib
import pickle
import resource
import tempfile
import unittest
import warnings

import advsage as sage
import numpy as np
from support import RECORDED, InFolder, needs, procedural, scene_files

try:
    import advsage.gym
    import gymnasium
    from advsage.gym import ScenarioEnv, ScenarioVectorEnv
    from gymnasium.utils.env_checker import check_env
    from gymnasium.vector import AutoresetMode
except ImportError as error:
    print(f"left out: environments need Gymnasium ({error})")
    raise SystemExit(0) from None

MODES = list(AutoresetMode)
#: Keys of the infos of one environment that MetaDrive has too.
METADRIVE = """crash_vehicle crash_object crash_building crash_human crash_sidewalk crash out_of_road arrive_dest max_step env_seed cost
num_crash_object num_crash_human num_crash_vehicle num_on_line step_reward step_reward_lateral step_reward_heading
step_reward_action_smooth track_length carsize route_completion lateral_dist scenario_index scenario_difficulty curriculum_level
data_coverage num_stored_maps curriculum_success curriculum_route_completion""".split()


def adversaries():
    """Every kind of adversary."""
    generator = sage.Generator()
    found = sage.search(procedural(7), "idm", budget=8, require="attack")
    return {
        "generator": generator,
        "half of the episodes": {"generator": sage.Generator(lambda_=0.3), "probability": 0.5},
        "drives": {"generator": generator, "against": "drives", "shared": False},
        "paper": {"curriculum": "paper", "total_steps": 6000, "shared": False},
        "adaptive": {"curriculum": "adaptive", "against": "drives", "total_steps": 6000, "shared": False},
        "search": {"search": "idm", "budget": 8, "require": "attack"},
        "plans": found,
    }


@contextlib.contextmanager
def quiet():
    """Attacks that cannot be planned in some scenes are no subject here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def actions(seed, steps, count):
    """Actions (steps, count, 2) that drive ahead."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (steps, count, 2))
    return (drawn * [0.2, 0.6] + [0.0, 0.2]).astype(np.float32)


def single_rows(config, seed, steps):
    """What an environment gives in a number of steps: (observation, reward, terminated, truncated, info), and after an end the reset."""
    env = ScenarioEnv(config)
    rows = [env.reset(seed=seed)]
    for action in steps:
        row = env.step(action)
        rows.append(row)
        if row[2] or row[3]:
            rows.append(env.reset())
    return rows


def column(infos, k):
    """The info of one environment, from columns."""
    return {key: values[k] for key, values in infos.items() if not key.startswith("_") and key not in ("final_obs", "final_info") and infos[f"_{key}"][k]}


class Checks(unittest.TestCase):
    """The checks of others."""

    def check(self, config):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            env = gymnasium.make(advsage.gym.NAME, config=config, render_mode="rgb_array").unwrapped
            # It gives what it warns of to a logger of its own.
            with self.assertNoWarnings():
                check_env(env)
                try:
                    from stable_baselines3.common.env_checker import check_env as check_sb3
                except ImportError:
                    return
                check_sb3(env)

    @contextlib.contextmanager
    def assertNoWarnings(self):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            yield
        self.assertEqual([str(one.message) for one in found], [])

    def test_procedural_and_recorded_scenes(self):
        self.check(None)
        for preset in ("default", "metadrive"):
            self.check({"preset": preset, "scenes": procedural(7)})
        if RECORDED:
            self.check({"data_directory": pathlib.Path(RECORDED) / "dev", "num_scenarios": 12})

    def test_adversaries(self):
        given = adversaries()
        failing = [failure.scene for failure in given["plans"]]
        for name, adversary in given.items():
            with self.subTest(adversary=name):
                scenes = failing if name in ("search", "plans") else procedural(3)
                self.check({"scenes": scenes, "adversary": adversary})


class Single(InFolder):
    def test_infos(self):
        env = ScenarioEnv({"scenes": procedural(3)})
        _, info = env.reset(seed=1)
        self.assertEqual([key for key in METADRIVE if key not in info], [])
        _, reward, _, _, info = env.step([0.0, 0.5])
        self.assertEqual(info["episode_length"], 1)
        self.assertEqual(info["episode_reward"], reward)
        self.assertEqual(info["step_reward"], reward)

    def test_scenes_by_number_and_name(self):
        scenes = procedural(7)
        env = ScenarioEnv({"scenes": scenes, "start_scenario_index": 2})
        self.assertEqual(env.reset(seed=3, options={"scenario": 4})[1]["scenario_index"], 4)
        self.assertEqual(env.reset(options={"scenario": scenes[6].name})[1]["scenario_index"], 6)
        for wrong in (1, 7, "nothing"):
            with self.assertRaises((sage.OptionError, sage.UnknownName)):
                env.reset(options={"scenario": wrong})
        with self.assertRaisesRegex(sage.UnknownName, "scenarios"):
            env.reset(options={"scenarios": 2})
        in_turn = ScenarioEnv({"scenes": scenes, "sequential_seed": True, "worker_index": 1, "num_workers": 3})
        found = [in_turn.reset(seed=0)[1]["scenario_index"]] + [in_turn.reset()[1]["scenario_index"] for _ in range(3)]
        self.assertEqual(found, [1, 4, 1, 4])

    def test_seeds(self):
        env = ScenarioEnv({"scenes": procedural(7)})
        for seed in (0, 123, 2**32, 2**64 - 1, 2**70):
            first, _ = env.reset(seed=seed)
            np.testing.assert_array_equal(first, env.reset(seed=seed)[0])
        for wrong in (-1, 1.5, "a"):
            with self.assertRaises((sage.OptionError, gymnasium.error.Error)):
                env.reset(seed=wrong)
        self.assertEqual(len({ScenarioEnv().reset()[0].tobytes() for _ in range(8)}) > 1, True)
        scenes = {env.reset()[1]["scenario_index"] for _ in range(60)}
        self.assertEqual(scenes, set(range(7)))
        metadrive = ScenarioEnv({"scenes": procedural(7), "preset": "metadrive"})
        self.assertEqual(metadrive.reset(seed=5)[1]["scenario_index"], 5)
        metadrive.reset(seed=123)

    def test_a_reset_with_a_seed_starts_anew(self):
        config = {"scenes": procedural(2), "adversary": {"generator": sage.Generator(), "against": "drives"}}
        env = ScenarioEnv(config)

        def run():
            rows = [env.reset(seed=4)]
            for action in actions(1, 200, 1)[:, 0]:
                rows.append(env.step(action))
                if rows[-1][2] or rows[-1][3]:
                    rows.append(env.reset())
            return [(row[0].tobytes(), row[-1]) for row in rows]

        first = run()
        self.assertTrue(all(one[0] == other[0] and one[1] == other[1] for one, other in zip(first, run())))

    def test_endings(self):
        def ending(**config):
            env = ScenarioEnv({"scenes": procedural(1), **config})
            env.reset(seed=0)
            for step in range(1, 400):
                _, _, terminated, truncated, info = env.step([0.0, -1.0])
                if terminated or truncated:
                    return step, terminated, truncated, info["max_step"]
            return None

        self.assertEqual(ending(), (90, False, True, True))
        self.assertEqual(ending(horizon=20), (20, False, True, True))
        self.assertEqual(ending(horizon=120), (120, False, True, True))
        self.assertEqual(ending(horizon=20, truncate_as_terminate=True), (20, True, False, True))
        self.assertIsNone(ending(horizon=None))
        self.assertEqual(ending(preset="metadrive")[0], 251)

    def test_rewards(self):
        def total(**config):
            env = ScenarioEnv({"scenes": procedural(1), "horizon": 15, **config})
            env.reset(seed=0)
            return sum(env.step([0.0, 0.4])[1] for _ in range(15))

        self.assertAlmostEqual(total(driving_reward=0.5), 0.5 * total())

    def test_calls_at_the_wrong_time_and_wrong_actions(self):
        env = ScenarioEnv({"scenes": procedural(1), "horizon": 2})
        with self.assertRaisesRegex(sage.OptionError, "never reset"):
            env.step([0.0, 0.0])
        env.reset(seed=0)
        for wrong in ([0.0], [[0.0, 0.0]], 3.0):
            with self.assertRaisesRegex(sage.OptionError, "shape"):
                env.step(wrong)
        with self.assertRaisesRegex(sage.OptionError, "finite"):
            env.step([0.0, float("nan")])
        env.step([0.0, 9.0])
        env.step(np.zeros((2, 3), np.float32)[:, 0])
        with self.assertRaisesRegex(sage.OptionError, "is over"):
            env.step([0.0, 0.0])

    def test_copies_are_refused(self):
        for env in (ScenarioEnv({"scenes": procedural(1)}), ScenarioVectorEnv(2, {"scenes": procedural(1)})):
            for way in (copy.copy, copy.deepcopy, pickle.dumps):
                with self.assertRaisesRegex(TypeError, "from its configuration"):
                    way(env)
            env.reset(seed=1)
            env.close()
            env.close()

    def test_seeds_are_told(self):
        env = ScenarioEnv({"scenes": procedural(7)})
        first, _ = env.reset()
        np.testing.assert_array_equal(first, env.reset(seed=env.np_random_seed)[0])
        envs = ScenarioVectorEnv(2, {"scenes": procedural(7)})
        envs.reset(seed=3)
        self.assertEqual(envs.np_random_seed, (3, 4))
        # A reset that fails leaves the seed to the next one.
        with self.assertRaises(sage.OptionError):
            env.reset(seed=5, options={"scenario": 99})
        new = ScenarioEnv({"scenes": procedural(7)})
        with self.assertRaises(sage.OptionError):
            new.reset(seed=5, options={"scenario": 99})
        new.reset()
        self.assertGreaterEqual(len({new.reset()[1]["scenario_index"] for _ in range(20)}), 4)

    def test_pictures(self):
        env = ScenarioEnv({"scenes": procedural(2)}, render_mode="rgb_array")
        with self.assertRaises(sage.OptionError):
            env.render()
        env.reset(seed=0)
        first = env.render()
        self.assertEqual((first.shape, first.dtype, first.flags["WRITEABLE"]), ((480, 480, 3), np.uint8, True))
        for _ in range(10):
            env.step([0.0, 0.2])
        self.assertTrue((env.render() != first).any())
        self.assertIsNone(ScenarioEnv().render())
        with self.assertRaises(sage.OptionError):
            ScenarioEnv(render_mode="human")

    def test_names_of_files_with_a_hash(self):
        path = os.path.join(self.folder, "a#b.pkl")
        procedural(1)[0].save(path)
        self.assertEqual(ScenarioEnv({"scenes": [path]}).reset(seed=0)[1]["scenario_index"], 0)

    def test_plans_are_read_once(self):
        scene = procedural(1)[0]
        plan = scene.positions[scene.adversary, 11:91, :2]
        given = (one for one in [sage.Failure(scene, {"trajectory": plan})])
        envs = ScenarioVectorEnv(2, {"scenes": [scene], "adversary": given})
        self.assertTrue(envs.reset(seed=0)[1]["under_attack"].all())

    def test_scenes_that_cannot_be_used(self):
        paths = scene_files(3, self.folder)[:3]
        damaged = os.path.join(self.folder, "damaged.pkl")
        pathlib.Path(damaged).write_bytes(b"nothing")
        env = ScenarioEnv({"scenes": [*paths, damaged]})
        with self.assertWarnsRegex(RuntimeWarning, "damaged"):
            for k in range(30):
                self.assertNotEqual(env.reset(seed=k)[1]["scenario_index"], 3)
        with self.assertRaises(sage.FormatError):
            env.reset(options={"scenario": 3})
        with self.assertRaises(sage.SageError):
            ScenarioEnv({"scenes": [damaged]}).reset(seed=0)
        given = {"plans": {"another": np.zeros((80, 2))}}
        with self.assertWarnsRegex(RuntimeWarning, "no attack"):
            _, info = ScenarioEnv({"scenes": paths, "adversary": given}).reset(seed=0)
        self.assertFalse(info["under_attack"])


class Configurations(unittest.TestCase):
    def refused(self, error, words, **config):
        with self.assertRaisesRegex(error, words):
            ScenarioEnv(config)

    def test_keys_of_metadrive(self):
        ScenarioEnv(
            {
                "no_light": True,
                "crash_vehicle_done": True,
                "vehicle_config": {"lidar": {"num_lasers": 30, "distance": 50, "num_others": 3}},
                "reactive_traffic": True,
                "horizon": 50,
                "num_scenarios": 3,
                "success_reward": 5,
                "out_of_road_cost": 2.0,
            }
        ).reset(seed=0)
        self.refused(sage.UnknownName, "nearest is 'horizon'", horizons=3)
        self.refused(sage.UnknownName, "nearest is 'no_static_vehicles'", no_static_vehicle=True)
        self.refused(sage.OptionError, "no_light is False; here it can only be True", no_light=False)
        self.refused(sage.OptionError, "num_lasers is 240; the observation has 30", vehicle_config={"lidar": {"num_lasers": 240}})
        self.refused(sage.UnknownName, "camera", vehicle_config={"camera": {}})
        self.refused(sage.UnknownName, "on_lane_line_penalty", on_lane_line_penalty=1.0)

    def test_a_whole_configuration_makes_the_same_environment(self):
        for preset in ("training", "default", "metadrive"):
            env = ScenarioEnv({"preset": preset, "scenes": procedural(4)})
            self.assertEqual(set(env.config), set(advsage.gym.DEFAULTS))
            again = ScenarioEnv(env.config)
            for one in (env, again):
                one.reset(seed=2)
            for action in actions(0, 60, 1)[:, 0]:
                rows = [one.step(action) for one in (env, again)]
                self.assertEqual(rows[0][0].tobytes(), rows[1][0].tobytes())
                self.assertEqual(rows[0][1:], rows[1][1:])
                if rows[0][2] or rows[0][3]:
                    break

    def test_values(self):
        for words, config in {
            "horizon is 0": {"horizon": 0},
            "crash_vehicle_done is 1": {"crash_vehicle_done": 1},
            "success_reward is nan": {"success_reward": float("nan")},
            "num_scenarios 99, of 42": {"num_scenarios": 99},
            "start_scenario_index is -1": {"start_scenario_index": -1},
            "exclude each other": {"data_directory": ".", "scenes": []},
            "start_scenario_index 0, of 0": {"scenes": []},
            "worker_index is 3": {"worker_index": 3, "num_workers": 2, "sequential_seed": True},
            "set sequential_seed": {"num_workers": 2},
            "num_workers is 1": {"num_workers": 10**30},
            "lidar is 3": {"vehicle_config": {"lidar": 3}},
            "threads is 0": {"threads": 0},
            "unknown preset": {"preset": "fast"},
            "unknown preset .'a'.": {"preset": ["a"]},
            "no scene": {"scenes": [3]},
        }.items():
            with self.subTest(config=words):
                self.refused((sage.OptionError, sage.UnknownName), words, **config)
        self.refused(FileNotFoundError, "nowhere", data_directory="nowhere")
        with self.assertRaisesRegex(sage.OptionError, "expected a dictionary"):
            ScenarioEnv(3)

    def test_adversaries(self):
        generator = sage.Generator()
        for words, adversary in {
            "attacks nothing": 3,
            "found none of them": {},
            "found generator and search": {"generator": generator, "search": "idm"},
            "expected a Generator": {"generator": "sage"},
            "nearest is 'generator'": {"generators": generator},
            "probability is 2": {"generator": generator, "probability": 2},
            "needs total_steps": {"curriculum": "paper"},
            "curriculum is 5": {"curriculum": 5},
            "leave probability out": {"curriculum": "paper", "total_steps": 9, "probability": 0.5},
            "total_steps is an option of a curriculum": {"generator": generator, "total_steps": 9},
            "curriculum is an option of a generator": {"search": "idm", "curriculum": "paper", "total_steps": 9},
            "unknown curriculum": {"curriculum": "steep", "total_steps": 9},
            'against is "log"|against is .log.': {"generator": generator, "against": "log"},
            "driver .*nobody|nobody": {"search": "nobody"},
            "sage.search": {"search": Still()},
            "a program": {"search": "cmd:touch it-ran"},
            "'py:.*a program": {"search": "py:os:abort"},
            "'process.*a program": {"search": 'process{"command": ["touch", "it-ran"]}'},
            "leave mu out": {"generator": sage.Generator(mu=0.5), "curriculum": "paper", "total_steps": 9},
            "budget is an option of a search": {"generator": generator, "budget": 3},
            "budget is 0": {"search": "idm", "budget": 0},
            "shared is 'no'": {"generator": generator, "shared": "no"},
            "weights is 7": {"search": "idm", "weights": 7},
            "positions": {"plans": {"a": np.zeros((3, 2))}},
        }.items():
            with self.subTest(adversary=words):
                self.refused((sage.OptionError, sage.UnknownName), words, adversary=adversary)
        self.assertFalse(os.path.exists("it-ran"))

    def test_curricula(self):
        env = ScenarioEnv({"scenes": procedural(7), "adversary": {"curriculum": "paper", "total_steps": 900}})
        with quiet():
            infos = [env.reset(seed=2)[1]]
            for _ in range(20):
                for _ in range(45):
                    if any(env.step([0.0, -1.0])[2:4]):
                        break
                infos.append(env.reset()[1])
        lambdas = [info["attack_lambda"] for info in infos if info["under_attack"]]
        self.assertEqual(lambdas, sorted(lambdas))
        self.assertGreater(lambdas[-1], 0.9)
        half = {"generator": sage.Generator(lambda_=0.25), "probability": 0.5}
        env = ScenarioEnv({"scenes": procedural(7), "adversary": half})
        with quiet():
            infos = [env.reset(seed=k)[1] for k in range(200)]
        attacked = sum(info["under_attack"] for info in infos)
        self.assertTrue(60 < attacked < 140, attacked)
        self.assertEqual({info["attack_lambda"] for info in infos if info["under_attack"]}, {0.25})

    def test_the_attack_is_that_of_the_generator(self):
        generator = sage.Generator(lambda_=0.7)
        scene = procedural(1)[0]
        trajectory = generator(scene).trajectory
        env = ScenarioEnv({"scenes": [scene], "adversary": generator, "preset": "default"})
        env.reset(seed=0)
        for step in range(1, 30):
            env.step([0.0, 0.0])
            shown = env._environments.picture(0)
            center = shown["corners"][shown["kinds"] == 1].mean(axis=(0, 1))
            then = trajectory[step - 11] if step > 10 else scene.positions[scene.adversary, step, :2]
            np.testing.assert_allclose(center, then, atol=1e-9)

    def test_rewards_and_costs(self):
        """Every key is measured by its own value, in steps in which it decides."""
        config = {
            "driving_reward": 2.0, "success_reward": 11.0, "out_of_road_penalty": 12.0, "crash_vehicle_penalty": 13.0,
            "crash_object_penalty": 14.0, "out_of_road_cost": 3.0, "crash_vehicle_cost": 4.0, "crash_object_cost": 5.0,
        }
        env = ScenarioEnv({"scenes": [*procedural(14), _with_a_cone()], **config})
        seen = set()
        for episode in range(80):
            env.reset(seed=episode, options={"scenario": 14} if episode % 8 == 0 else None)
            for step in range(200):
                steer = 0.0 if episode % 2 else 0.3
                _, reward, terminated, truncated, info = env.step([steer, 0.5 if episode % 4 else 1.0])
                kind, cost = "way", 0.0
                if info["crash_object"]:
                    kind, cost = "crash_object", 5.0
                if info["crash_vehicle"]:
                    kind, cost = "crash_vehicle", 4.0
                if info["out_of_road"] and info["cost"]:
                    kind, cost = "out_of_road", 3.0
                penalties = {"crash_object": -14.0, "crash_vehicle": -13.0, "out_of_road": -12.0, "way": info["step_reward"]}
                self.assertEqual(info["cost"], cost)
                self.assertEqual(reward, 11.0 if info["arrive_dest"] else penalties[kind])
                seen.add("arrive_dest" if info["arrive_dest"] else kind)
                if terminated or truncated:
                    break
        self.assertEqual(seen, {"way", "arrive_dest", "out_of_road", "crash_vehicle", "crash_object"})

    def test_driving_backwards_is_off_the_road(self):
        env = ScenarioEnv({"scenes": procedural(5)[4:], "horizon": None})
        env.reset(seed=0)
        back = env._environments.picture(0)["ego"][2] + np.pi
        for step in range(300):
            # It brakes, then turns round.
            off = (env._environments.picture(0)["ego"][2] - back + np.pi) % (2 * np.pi) - np.pi
            steer = float(np.clip(-off, -1, 1)) if abs(off) < 2.9 else 1.0
            _, reward, terminated, _, info = env.step([steer, 0.2 if step > 25 else -0.5])
            if terminated:
                break
        self.assertLess(info["route_completion"], -0.1)
        # MetaDrive says so too, without penalty and cost.
        self.assertEqual((info["out_of_road"], info["cost"], reward > -1), (True, 0.0, True))


def _with_a_cone():
    """A scene with a cone on the route."""
    scene = procedural(1)[0]
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "cone.pkl")
        scene.save(path)
        with open(path, "rb") as file:
            content = pickle.load(file)
        ego = content["tracks"][scene.track_ids[scene.ego]]
        cone = copy.deepcopy(ego)
        cone["type"] = "TRAFFIC_CONE"
        cone["metadata"].update(type="TRAFFIC_CONE", object_id="cone")
        state = cone["state"]
        state["position"][:] = ego["state"]["position"][45]
        state["velocity"][:] = 0.0
        state["heading"][:] = 0.0
        state["valid"][:] = True
        for side in ("length", "width", "height"):
            state[side][:] = 0.5
        content["tracks"]["cone"] = cone
        with open(path, "wb") as file:
            pickle.dump(content, file)
        return sage.load(path)


class Still:
    """A planner."""

    def act(self, obs):
        return 0.0, -1.0


class Vector(unittest.TestCase):
    def check_vector(self, envs, steps=130):
        """The check of vector environments that Gymnasium has not."""
        n, mode = envs.num_envs, envs.metadata["autoreset_mode"]
        self.assertEqual(envs.observation_space.shape, (n, 101))
        self.assertEqual(envs.action_space.shape, (n, 2))

        def check(observations, infos, where):
            self.assertIn(observations, envs.observation_space)
            self.assertEqual((observations.dtype, observations.shape), (np.float32, (n, 101)))
            for key, values in infos.items():
                if key.startswith("_"):
                    self.assertEqual((values.dtype, values.shape), (np.bool_, (n,)), key)
                    self.assertIn(key[1:], infos)
                elif key == "final_info":
                    check_columns(values, infos["_final_info"])
                else:
                    self.assertEqual(len(values), n, key)
                    self.assertIn(f"_{key}", infos)
            if where is not None:
                self.assertTrue((infos["_route_completion"] == where).all())

        def check_columns(columns, where):
            for key, values in columns.items():
                if key.startswith("_"):
                    self.assertFalse((values & ~where).any(), key)
                else:
                    self.assertEqual(len(values), n, key)

        observations, infos = envs.reset(seed=5)
        check(observations, infos, np.ones(n, bool))
        over = np.zeros(n, bool)
        kept = []
        for action in actions(3, steps, n):
            if mode == AutoresetMode.DISABLED and over.any():
                with self.assertRaisesRegex(sage.OptionError, "is over"):
                    envs.step(action)
                before = observations
                observations, infos = envs.reset(options={"reset_mask": over})
                check(observations, infos, over)
                np.testing.assert_array_equal(observations[~over], before[~over])
            result = envs.step(action)
            observations, rewards, terminated, truncated, infos = result
            check(observations, infos, None)
            self.assertEqual((rewards.dtype, rewards.shape), (np.float64, (n,)))
            for flags in (terminated, truncated):
                self.assertEqual((flags.dtype, flags.shape), (np.bool_, (n,)))
            if mode == AutoresetMode.NEXT_STEP:
                self.assertFalse((terminated | truncated)[over].any())
                self.assertTrue((rewards[over] == 0.0).all() and (infos["episode_length"][over] == 0).all())
            over = terminated | truncated
            if mode == AutoresetMode.SAME_STEP and over.any():
                np.testing.assert_array_equal(infos["_final_obs"], over)
                np.testing.assert_array_equal(infos["_final_info"], over)
                self.assertEqual(infos["final_obs"].dtype, object)
                for k in range(n):
                    if over[k]:
                        self.assertIn(infos["final_obs"][k], envs.single_observation_space)
                        self.assertEqual(infos["final_info"]["episode_reward"].dtype, np.float64)
                        self.assertGreater(infos["final_info"]["episode_length"][k], 0)
                        self.assertEqual(infos["episode_length"][k], 0)
                    else:
                        self.assertIsNone(infos["final_obs"][k])
            else:
                self.assertNotIn("final_obs", infos)
            kept.append((result, copy.deepcopy(result)))
        for result, then in kept:
            for one, other in zip(result[:4], then[:4]):
                np.testing.assert_array_equal(one, other)
            for key in result[4]:
                if key not in ("final_obs", "final_info"):
                    np.testing.assert_array_equal(result[4][key], then[4][key])

    def test_shapes_types_and_masks(self):
        for mode in MODES:
            for config in ({}, {"scenes": procedural(7), "adversary": sage.Generator(), "threads": 2}):
                with self.subTest(mode=mode), quiet():
                    self.check_vector(ScenarioVectorEnv(5, config, autoreset_mode=mode))

    def equal_to_singles(self, config, threads=1, steps=220, n=3):
        """Compares with environments on their own, step for step and bit for bit."""
        chosen = actions(8, steps, n)
        own = dict(config)
        adversary = own.get("adversary")
        if isinstance(adversary, dict) and "total_steps" in adversary:
            own["adversary"] = {**adversary, "total_steps": adversary["total_steps"] // n}
        # Each is a worker of its own.
        workers = [{"worker_index": k, "num_workers": n} if "sequential_seed" in config else {} for k in range(n)]
        with quiet():
            expected = [single_rows({**own, **workers[k]}, 30 + k, chosen[:, k]) for k in range(n)]
        resets = 0
        for mode in MODES:
            envs = ScenarioVectorEnv(n, {**config, "threads": threads}, autoreset_mode=mode)
            with quiet():
                observations, infos = envs.reset(seed=30)
            at, given = [0] * n, [0] * n
            over = np.zeros(n, bool)

            def compare(k, observation, info, reward=None, ends=None):
                row = expected[k][at[k]]
                at[k] += 1
                self.assertEqual(observation.tobytes(), row[0].tobytes(), (mode, k, at[k]))
                for key, value in info.items():
                    if key not in ("episode_reward", "episode_length") or len(row) == 5:
                        self.assertEqual(value, row[-1][key], (mode, k, key))
                if len(row) == 5:
                    self.assertEqual((reward, *ends), row[1:4])

            for k in range(n):
                compare(k, observations[k], column(infos, k))
            while min(given) < steps - 2:
                action = np.stack([chosen[min(given[k], steps - 1), k] for k in range(n)])
                with quiet():
                    if mode == AutoresetMode.DISABLED and over.any():
                        observations, infos = envs.reset(options={"reset_mask": over})
                        for k in np.flatnonzero(over):
                            compare(k, observations[k], column(infos, k))
                    observations, rewards, terminated, truncated, infos = envs.step(action)
                for k in range(n):
                    if given[k] >= steps - 1:
                        continue
                    ends = (terminated[k], truncated[k])
                    if mode == AutoresetMode.SAME_STEP and any(ends):
                        last = column(infos["final_info"], k)
                        compare(k, infos["final_obs"][k], last, rewards[k], ends)
                        compare(k, observations[k], column(infos, k))
                        given[k] += 1
                        resets += 1
                    elif mode == AutoresetMode.NEXT_STEP and over[k]:
                        compare(k, observations[k], column(infos, k))
                    else:
                        compare(k, observations[k], column(infos, k), rewards[k], ends)
                        given[k] += 1
                over = terminated | truncated
        self.assertGreater(resets, 3)

    def test_equal_to_single_environments(self):
        scenes = procedural(7)
        self.equal_to_singles({"scenes": scenes})
        self.equal_to_singles({"scenes": scenes}, threads=2)
        self.equal_to_singles({"scenes": scenes, "preset": "metadrive"}, steps=600, n=2)
        self.equal_to_singles({"scenes": scenes, "sequential_seed": True, "reactive_traffic": True})
        for name, adversary in adversaries().items():
            with self.subTest(adversary=name):
                self.equal_to_singles({"scenes": scenes, "adversary": adversary})

    @unittest.skipUnless(RECORDED, "left out: recorded scenes")
    def test_equal_on_recorded_scenes(self):
        config = {"data_directory": pathlib.Path(RECORDED) / "dev", "num_scenarios": 10, "scenes_in_memory": 3}
        self.equal_to_singles(config)
        self.equal_to_singles({**config, "adversary": sage.Generator()}, threads=2)

    def test_roll_outs(self):
        scenes = procedural(7)
        for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
            envs = [ScenarioVectorEnv(3, {"scenes": scenes, "adversary": {"generator": sage.Generator(), "shared": False}}, autoreset_mode=mode) for _ in range(2)]
            chosen = actions(4, 120, 3)
            with quiet():
                for one in envs:
                    one.reset(seed=1)
                rolled = envs[0].roll_out(chosen.transpose(1, 0, 2))
                for step, action in enumerate(chosen):
                    stepped = envs[1].step(action)
                    for one, all_steps in zip(stepped[:4], rolled[:4]):
                        np.testing.assert_array_equal(one, all_steps[:, step])
                    for k in range(3):
                        self.assertEqual(column(stepped[4], k), column(rolled[4], k * 120 + step))
                        if "final_obs" in stepped[4] and stepped[4]["_final_obs"][k]:
                            np.testing.assert_array_equal(stepped[4]["final_obs"][k], rolled[4]["final_obs"][k * 120 + step])
        disabled = ScenarioVectorEnv(2, {"scenes": scenes}, autoreset_mode=AutoresetMode.DISABLED)
        disabled.reset(seed=0)
        with self.assertRaisesRegex(sage.OptionError, "automatic reset"):
            disabled.roll_out(np.zeros((2, 3, 2)))

    def test_environments_do_not_disturb_each_other(self):
        scenes = procedural(5)

        def run(disturbed):
            env = ScenarioVectorEnv(4, {"scenes": scenes}, autoreset_mode=AutoresetMode.SAME_STEP)
            other = ScenarioEnv({"scenes": scenes, "adversary": sage.Generator()})
            found = [env.reset(seed=2)[0].tobytes()]
            for k, action in enumerate(actions(0, 150, 4)):
                if disturbed:
                    with quiet():
                        other.reset(seed=k)
                    other.step(action[0])
                found.append(env.step(action)[0].tobytes())
            return found

        self.assertEqual(run(False), run(True))

    def test_what_is_shared_does_not_depend_on_threads(self):
        def run(threads):
            adversary = {"curriculum": "adaptive", "against": "drives", "total_steps": 2000}
            envs = ScenarioVectorEnv(6, {"scenes": procedural(3), "adversary": adversary, "threads": threads})
            with quiet():
                rows = [envs.reset(seed=7)[0].tobytes()]
                rows += [envs.step(action)[0].tobytes() for action in actions(2, 250, 6)]
            return rows

        self.assertEqual(run(1), run(2))

    def test_registered(self):
        config = {"scenes": procedural(4)}
        env = gymnasium.make(advsage.gym.NAME, config=config)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        for mode in MODES:
            envs = gymnasium.make_vec(advsage.gym.NAME, num_envs=3, config=config, autoreset_mode=mode)
            self.assertIsInstance(envs, ScenarioVectorEnv)
            self.assertIs(envs.metadata["autoreset_mode"], mode)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sync = gymnasium.make_vec(advsage.gym.NAME, num_envs=2, vectorization_mode="sync", config=config)
        own = gymnasium.make_vec(advsage.gym.NAME, num_envs=2, config=config)
        np.testing.assert_array_equal(sync.reset(seed=3)[0], own.reset(seed=3)[0])
        for action in actions(5, 200, 2):
            for one, other in zip(sync.step(action)[:4], own.step(action)[:4]):
                np.testing.assert_array_equal(one, other)

    def test_wrappers(self):
        from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

        for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
            def new():
                return ScenarioVectorEnv(3, {"scenes": procedural(4), "horizon": 20}, autoreset_mode=mode)

            # One over the other fails in Gymnasium 1.1, whatever the environment.
            counted, listed = RecordEpisodeStatistics(new()), DictInfoToList(new())
            counted.reset(seed=0)
            listed.reset(seed=0)
            lengths = []
            for _ in range(50):
                action = np.tile(np.float32([0.0, 0.2]), (3, 1))
                infos = counted.step(action)[4]
                if "episode" in infos:
                    lengths += infos["episode"]["l"][infos["_episode"]].tolist()
                listed_infos = listed.step(action)[4]
                self.assertEqual([info["episode_length"] for info in listed_infos], infos["episode_length"].tolist())
            self.assertTrue(lengths and max(lengths) <= 20, lengths)

    def test_wrong_calls(self):
        envs = ScenarioVectorEnv(2, {"scenes": procedural(2)})
        with self.assertRaisesRegex(sage.OptionError, "never reset"):
            envs.step(np.zeros((2, 2)))
        envs.reset(seed=[3, None])
        for wrong in (np.zeros(2), np.zeros((3, 2)), np.zeros((2, 3))):
            with self.assertRaisesRegex(sage.OptionError, "shape"):
                envs.step(wrong)
        with self.assertRaisesRegex(sage.OptionError, "environment 1"):
            envs.step([[0, 0], [0, float("inf")]])
        for seed in ([1], [1, 2, 3]):
            with self.assertRaisesRegex(sage.OptionError, "expected 2"):
                envs.reset(seed=seed)
        for mask in ([True, False], np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
            with self.assertRaisesRegex(sage.OptionError, "reset_mask"):
                envs.reset(options={"reset_mask": mask})
        self.assertEqual(envs.reset(options={"scenario": [1, 0]})[1]["scenario_index"].tolist(), [1, 0])
        self.assertEqual(envs.reset(options={"scenario": 1})[1]["scenario_index"].tolist(), [1, 1])
        for count in (0, -1, 2.0, True):
            with self.assertRaisesRegex(sage.OptionError, "num_envs"):
                ScenarioVectorEnv(count)
        with self.assertRaisesRegex(sage.OptionError, "autoreset_mode"):
            ScenarioVectorEnv(1, autoreset_mode="later")

    def test_fork_with_threads(self):
        config = {"scenes": procedural(3), "threads": 2}
        envs = ScenarioVectorEnv(4, config, autoreset_mode=AutoresetMode.SAME_STEP)
        envs.reset(seed=1)
        envs.step(np.zeros((4, 2)))
        context = multiprocessing.get_context("fork")
        receiver, sender = context.Pipe(False)

        def child():
            sender.send(envs.step(np.zeros((4, 2)))[0].tobytes())

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            process = context.Process(target=child)
            process.start()
        self.assertTrue(receiver.poll(60), "the child hangs")
        self.assertEqual(receiver.recv(), envs.step(np.zeros((4, 2)))[0].tobytes())
        process.join()

    def test_memory_stays(self):
        """Resets of 16 environments; the resident size after the first tenth grows by at most 5 %."""
        count = int(os.environ.get("SAGE_RESETS", "200"))
        if not pathlib.Path("/proc/self/statm").exists():
            self.skipTest("left out: the size of a process needs /proc")
        # Episodes that are long enough to be attacked later, and fewer scenes in memory than there are.
        adversary = {"generator": sage.Generator(), "against": "drives", "probability": 0.02}
        with tempfile.TemporaryDirectory() as folder:
            config = {"scenes": scene_files(30, folder), "scenes_in_memory": 8, "adversary": adversary}
            envs = ScenarioVectorEnv(16, config, autoreset_mode=AutoresetMode.SAME_STEP)
            first = None
            with quiet():
                for k in range(count):
                    envs.reset()
                    for action in actions(k, 25, 16):
                        envs.step(action)
                    if k == count // 10:
                        first = _resident()
        print(f"resident size after {count} resets: {_resident() / 2**20:.0f} MB, {_resident() / first:.3f} of that after a tenth")
        self.assertLess(_resident() / first, 1.05 if count >= 10_000 else 1.2)


def _resident():
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


class StableBaselines(InFolder):
    @needs("stable_baselines3", "the adapter")
    def test_the_adapter(self):
        from advsage.gym.sb3 import ScenarioVecEnv
        from stable_baselines3.common.monitor import Monitor

        envs = ScenarioVecEnv(3, {"scenes": procedural(4), "horizon": 10})
        envs.seed(5)
        observations = envs.reset()
        own = ScenarioVectorEnv(3, {"scenes": procedural(4), "horizon": 10}, autoreset_mode=AutoresetMode.SAME_STEP)
        np.testing.assert_array_equal(observations, own.reset(seed=5)[0])
        ended = 0
        for action in actions(1, 25, 3):
            observations, rewards, done, infos = envs.step(action)
            other, _, terminated, truncated, columns = own.step(action)
            np.testing.assert_array_equal(observations, other)
            self.assertEqual(rewards.dtype, np.float32)
            for k in range(3):
                if not done[k]:
                    self.assertEqual(infos[k], {})
                    continue
                ended += 1
                np.testing.assert_array_equal(infos[k]["terminal_observation"], columns["final_obs"][k])
                self.assertEqual(infos[k]["TimeLimit.truncated"], truncated[k] and not terminated[k])
                self.assertEqual(infos[k]["episode"]["l"], columns["final_info"]["episode_length"][k])
        self.assertGreaterEqual(ended, 6)
        self.assertEqual(envs.get_attr("num_envs"), [3, 3, 3])
        self.assertEqual(envs.env_is_wrapped(Monitor), [True] * 3)
        self.assertEqual(envs.env_is_wrapped(gymnasium.wrappers.TimeLimit), [False] * 3)
        self.assertEqual(envs.columns["cost"].shape, (3,))
        envs.set_options({"scenari": 2})
        with self.assertRaises(sage.UnknownName):
            envs.reset()
        self.assertEqual(len(envs.env_method("render")), 3)

    @needs("stable_baselines3", "training")
    def test_td3_and_its_buffer(self):
        import torch
        from advsage.gym.sb3 import ScenarioVecEnv
        from stable_baselines3 import TD3

        torch.set_num_threads(1)
        envs = ScenarioVecEnv(4, {"scenes": procedural(7), "horizon": 15})
        model = TD3("MlpPolicy", envs, learning_starts=200, train_freq=4, gradient_steps=1, policy_kwargs={"net_arch": [32, 32]}, seed=0)
        model.learn(2000)
        self.assertEqual(model.num_timesteps, 2000)
        buffer = model.replay_buffer
        cut = buffer.timeouts[: buffer.pos].astype(bool)
        ends = buffer.dones[: buffer.pos].astype(bool)
        self.assertGreater(cut.sum(), 60)
        # A truncation is an end whose value is still estimated.
        self.assertTrue((ends | ~cut).all())

    @needs("stable_baselines3", "training")
    def test_a_trained_policy_drives(self):
        import torch
        from advsage.gym.sb3 import ScenarioVecEnv
        from stable_baselines3 import PPO
        from stable_baselines3.common.evaluation import evaluate_policy

        torch.set_num_threads(1)
        envs = ScenarioVecEnv(4, {"scenes": procedural(7)})
        model = PPO("MlpPolicy", envs, n_steps=64, batch_size=64, seed=0)
        model.learn(512)
        mean, _ = evaluate_policy(model, ScenarioEnv({"scenes": procedural(2)}), n_eval_episodes=2, warn=False)
        self.assertTrue(np.isfinite(mean))
        drive = sage.simulate(procedural(1)[0], sage.planner.from_gym(model))
        self.assertGreater(len(drive.trajectory), 50)


if __name__ == "__main__":
    unittest.main()
