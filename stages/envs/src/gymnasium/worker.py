"""Plays Gymnasium environments for the program that started it, over its standard streams.

First line of the standard input: what to play, as JSON. First answer: MAGIC, a length (u32), and JSON that says what the
environments show and take, or why they cannot be played. From then on every request and every reply has a fixed size
(protocol.rs has the layout). The worker ends when its input ends, or when the process that started it is gone.
"""

import json
import os
import signal
import struct
import sys
import threading
import time
import traceback
import warnings

PROTOCOL = 1
MAGIC = b"DRILGYM1"
REQUEST = struct.Struct("<BxxxIQ")  # operation, environment, seed
REPLY = struct.Struct("<IBBxxId")  # mark, operation, outcome, environment, reward
MARK = 0x4D595244
RESET, STEP, RENDER = b"RSP"
RUNNING, FINISHED, FAILED, TIME_LIMIT = range(4)
TRACK_DRAWS = 24
ATARI = {  # every default of AtariVectorEnv that changes what is played, set here on purpose
    "frameskip": 4,
    "maxpool": True,
    "noop_max": 30,
    "use_fire_reset": True,
    "episodic_life": False,
    "life_loss_info": False,
    "reward_clipping": False,
    "repeat_action_probability": 0.0,
    "full_action_space": False,
}
ATARI_TIME_LIMIT = 27_000  # steps, of four frames each: half an hour of play


class Refused(Exception):
    """Why the environments cannot be played; `kind` is for the program, the text for people."""

    def __init__(self, kind, message):
        super().__init__(message)
        self.kind = kind


class Draws:
    """Stands for an environment's random generator, and gives the uniform numbers that were handed over."""

    def __init__(self, numbers):
        self.numbers = iter(numbers)

    def uniform(self, low, high):
        try:
            return low + (high - low) * next(self.numbers)
        except StopIteration:
            raise RuntimeError("the track needs more draws than were handed over: it did not close") from None


class Plain:
    """An environment of gymnasium.make. Made anew for every episode, so that nothing carries over."""

    def __init__(self, gymnasium, order):
        self.gymnasium, self.order = gymnasium, order
        self.env = None
        self.make()
        env = self.env.unwrapped
        self.is_car = type(env).__name__ == "CarRacing" and getattr(env, "continuous", False)
        self.is_lander = type(env).__name__ == "LunarLander"
        self.observation = self.see()
        self.action = self.act_as()

    def make(self):
        if self.env is not None:
            self.env.close()
        settings = dict(self.order["kwargs"])
        if self.order["time_limit"] is not None:
            settings["max_episode_steps"] = self.order["time_limit"]
        if self.order["images"]:
            settings["render_mode"] = "rgb_array"
        self.env = self.gymnasium.make(self.order["id"], **settings)

    def see(self):
        space = self.env.observation_space
        spaces = self.gymnasium.spaces
        shape = getattr(space, "shape", None)
        if isinstance(space, spaces.Box) and space.dtype == "uint8" and len(shape) in (2, 3):
            channels = shape[2] if len(shape) == 3 else 1
            if channels in (1, 3):
                return {"image": {"height": shape[0], "width": shape[1], "channels": channels}}
        if not space.is_np_flattenable:
            raise Refused("space", f"it shows {space}, expected an image or something that becomes a vector")
        return {"vector": {"len": int(spaces.flatten_space(space).shape[0])}}

    def act_as(self):
        space = self.env.action_space
        if isinstance(space, self.gymnasium.spaces.Discrete):
            return {"discrete": {"actions": int(space.n)}}
        if isinstance(space, self.gymnasium.spaces.Box):
            # The car's throttle and brake are one pedal, as its players have them.
            return {"continuous": {"dims": 2 if self.is_car else int(space.low.size)}}
        raise Refused("space", f"it takes {space}, expected a Box or Discrete action space")

    def image_size(self):
        self.env.reset(seed=0)
        return list(self.image().shape[:2])

    def image(self):
        return self.env.render()

    def reset(self, seed, draws):
        self.make()
        if draws is not None:
            self.env.unwrapped.np_random = Draws(draws)
            seed = None
        seen, _ = self.env.reset(seed=seed)
        return self.bytes_of(seen)

    def step(self, action):
        seen, reward, terminated, truncated, info = self.env.step(self.translate(action))
        outcome = RUNNING
        if terminated:
            lost = not info.get("lap_finished", True) or (self.is_lander and reward <= -100)
            outcome = FAILED if lost else FINISHED
        elif truncated:
            outcome = TIME_LIMIT
        return self.bytes_of(seen), float(reward), outcome

    def translate(self, action):
        import numpy

        space = self.env.action_space
        if isinstance(space, self.gymnasium.spaces.Discrete):
            return int(space.start) + int(action[0])
        if self.is_car:
            steer, pedal = action
            return numpy.array([steer, max(pedal, 0.0), max(-pedal, 0.0)], dtype=space.dtype)
        action = numpy.asarray(action, dtype=numpy.float64).reshape(space.shape)
        bounded = numpy.isfinite(space.low) & numpy.isfinite(space.high)
        low = numpy.where(bounded, space.low, -1.0)
        high = numpy.where(bounded, space.high, 1.0)
        return numpy.clip(low + (action + 1.0) / 2.0 * (high - low), low, high).astype(space.dtype)

    def bytes_of(self, seen):
        import numpy

        if "image" in self.observation:
            return numpy.ascontiguousarray(seen).tobytes()
        flat = self.gymnasium.spaces.flatten(self.env.observation_space, seen)
        return numpy.asarray(flat, dtype="<f4").tobytes()


class Atari:
    """A game of the Arcade Learning Environment: one AtariVectorEnv of one environment, so that each starts its own
    episodes. It shows the newest greyscale frame; whoever reads the frames stacks them."""

    def __init__(self, order, game):
        unknown = sorted(set(order["kwargs"]) - set(ATARI))
        if unknown:
            known = ", ".join(ATARI)
            raise Refused("settings", f"Atari has no setting {', '.join(unknown)}; its settings are {known}")
        self.settings = ATARI | order["kwargs"]
        self.limit = order["time_limit"] or ATARI_TIME_LIMIT
        self.game, self.steps = game, 0
        self.env = self.make(84, 84, True)
        # The same game in colour, for people.
        self.show = self.make(210, 160, False) if order["images"] else None
        self.colours = None
        self.observation = {"image": {"height": 84, "width": 84, "channels": 1}}
        self.action = {"discrete": {"actions": int(self.env.single_action_space.n)}}

    def make(self, height, width, grey):
        from ale_py.vector_env import AtariVectorEnv

        return AtariVectorEnv(
            game=self.game,
            num_envs=1,
            batch_size=0,
            num_threads=1,
            thread_affinity_offset=-1,
            max_num_frames_per_episode=2**31 - 1,  # steps are counted here
            continuous=False,
            autoreset_mode="NextStep",  # never seen: an episode that is over is not stepped
            img_height=height,
            img_width=width,
            grayscale=grey,
            stack_num=1,
            **self.settings,
        )

    def image_size(self):
        return [210, 160]

    def image(self):
        return self.colours

    def reset(self, seed, _draws):
        seeds = [seed & 0x7FFFFFFF]  # the emulator takes 31 bits
        import numpy

        self.steps = 0
        seen, _ = self.env.reset(seed=numpy.array(seeds, dtype=numpy.int32))
        if self.show:
            self.colours = self.show.reset(seed=numpy.array(seeds, dtype=numpy.int32))[0][0, 0]
        return seen.tobytes()

    def step(self, action):
        import numpy

        chosen = numpy.array([int(action[0])], dtype=numpy.int32)
        seen, reward, terminated, truncated, _ = self.env.step(chosen)
        if self.show:
            self.colours = self.show.step(chosen)[0][0, 0]
        self.steps += 1
        outcome = RUNNING
        if terminated[0]:
            outcome = FINISHED
        elif truncated[0] or self.steps >= self.limit:
            outcome = TIME_LIMIT
        return seen.tobytes(), float(reward[0]), outcome


def make(order):
    """The environments, or Refused."""
    try:
        import ale_py
        import gymnasium
    except ImportError as error:
        raise Refused("missing", str(error)) from None
    gymnasium.logger.min_level = gymnasium.logger.ERROR
    gymnasium.register_envs(ale_py)
    errors = gymnasium.error
    try:
        spec = gymnasium.spec(order["id"])
        if str(spec.entry_point).startswith("ale_py"):
            return [Atari(order, spec.kwargs["game"]) for _ in range(order["count"])]
        return [Plain(gymnasium, order) for _ in range(order["count"])]
    except (errors.UnregisteredEnv, errors.DeprecatedEnv) as error:
        raise Refused("unknown", str(error)) from None
    except errors.DependencyNotInstalled as error:
        raise Refused("missing", str(error)) from None
    except Refused:
        raise
    except Exception as error:
        raise Refused("settings", f"{type(error).__name__}: {error}") from None


def versions(names):
    from importlib import metadata

    found = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def greet(order):
    """The environments and the first answer."""
    envs, answer = [], {"protocol": PROTOCOL}
    try:
        answer["versions"] = versions(order["packages"])
        envs = make(order)
        answer["observation"], answer["action"] = envs[0].observation, envs[0].action
        if order["images"]:
            answer["image"] = envs[0].image_size()
    except Refused as refused:
        answer["refused"] = {"kind": refused.kind, "message": str(refused)}
    return envs, answer


def leave_with_the_parent():
    """Ends this process when the one that started it is gone, even while a step hangs."""
    parent = os.getppid()

    def watch():
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def serve(envs, answer, order, requests, replies):
    actions = answer["action"].get("continuous", {"dims": 1})["dims"]
    step_size = 4 * actions
    draws_size = 8 * TRACK_DRAWS if order["draws"] else 0
    while header := requests.read(REQUEST.size):
        operation, index, seed = REQUEST.unpack(header)
        env, reward, outcome = envs[index], 0.0, RUNNING
        if operation == RESET:
            draws = struct.unpack(f"<{TRACK_DRAWS}d", requests.read(draws_size)) if draws_size else None
            payload = env.reset(seed, draws)
        elif operation == STEP:
            payload, reward, outcome = env.step(struct.unpack(f"<{actions}f", requests.read(step_size)))
        elif operation == RENDER:
            payload = env.image().tobytes()
        else:
            raise ValueError(f"unknown operation {operation}")
        replies.write(REPLY.pack(MARK, operation, outcome, index, reward))
        replies.write(payload)
        replies.flush()


def main():
    # Who stops a stage signals its whole process group; when the stage has saved its state, it ends this process itself.
    for stop in (signal.SIGINT, signal.SIGTERM):
        signal.signal(stop, signal.SIG_IGN)
    requests = os.fdopen(os.dup(0), "rb", buffering=1 << 16)
    replies = os.fdopen(os.dup(1), "wb", buffering=1 << 16)
    os.dup2(2, 1)  # whatever a package prints must not get between the replies
    leave_with_the_parent()
    warnings.filterwarnings("ignore")
    os.environ.update(SDL_VIDEODRIVER="dummy", SDL_AUDIODRIVER="dummy", PYGAME_HIDE_SUPPORT_PROMPT="1")
    order = json.loads(requests.readline())
    envs, answer = greet(order)
    text = json.dumps(answer).encode()
    replies.write(MAGIC + struct.pack("<I", len(text)) + text)
    replies.flush()
    if "refused" not in answer:
        serve(envs, answer, order, requests, replies)


try:
    main()
except BrokenPipeError:
    os._exit(1)
except Exception:
    traceback.print_exc()
    sys.stderr.flush()
    os._exit(1)
sys.stderr.flush()
os._exit(0)  # no package's clean-up may hold the process
