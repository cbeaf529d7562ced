"""`planspace play`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.config_files import check_least, load_or_name
from planspace.cli.tables import counted
from planspace.errors import UsageError


@dataclass(frozen=True)
class Play:
    """Play a trained policy and film it.

    Episodes are deterministic: every action is the mean of the policy.
    """

    run: Positional[Annotated[Path, arg(metavar="RUN")]]
    """The folder of a `planspace train`, or of a `planspace run` with policies of several arms; or the name
    of a ready-made policy."""
    arm: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: the only one)")] = ""
    """Which arm of a `planspace run` to play; without it the arms are listed."""
    task: Annotated[str, arg(metavar="TASK", help_behavior_hint="(default: that of the run)")] = ""
    """module.py:NAME, if the policy was trained on your own Task or GymTask. A run on a planning
    problem holds its task."""
    seed: Annotated[str, arg(metavar="best|N")] = "best"
    """The seed to play. best: the seed with the highest return in the last evaluation."""
    pixels: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """An encoder of `planspace pixels`. The policy then sees what the encoder reads from pictures: z, and the
    estimated state where it observes the state."""
    episodes: Annotated[int, arg(metavar="N")] = 10
    """Number of episodes."""
    start_seed: int = 1000
    """Seed of the first episode's start. The other episodes use the seeds after it."""
    video: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Film the episodes as FILE.gif, or as FILE.mp4 (extra `video`)."""

    def __call__(self) -> None:
        """Play, print the returns, and save the film."""
        from planspace.demos.render import check_film
        from planspace.embed.pixels.saved import load_image_encoder
        from planspace.rl.play import film, play
        from planspace.rl.saved_policy import load_policy
        from planspace.tasks.gymnasium import find_training_task

        self._check()
        if self.video is not None:
            check_film(self.video)
            if not self.video.parent.exists():
                raise UsageError(f"there is no folder {self.video.parent}: make it, or give another --video.")
        policy = load_policy(self._chosen_run(), "best" if self.seed == "best" else int(self.seed))
        task = find_training_task(load_or_name(self.task)) if self.task else None
        encoder = None if self.pixels is None else load_image_encoder(self.pixels)
        returns, demos = play(policy, self.episodes, self.start_seed, task, encoder=encoder)
        print(f"seed {policy.seed}, {counted(len(returns), 'episode')} of {policy.about['task']}")
        print(f"return: mean {returns.mean():.1f}, worst {returns.min():.1f}, best {returns.max():.1f}")
        if self.video is not None:
            film(policy, demos, self.video, task)
            print(self.video)

    def _check(self) -> None:
        check_least(self, episodes=1, start_seed=0)
        if self.seed != "best" and not (self.seed.isascii() and self.seed.isdigit()):
            raise UsageError(f"`--seed` must be best or a number, got {self.seed!r}.")

    def _chosen_run(self) -> Path:
        from planspace.rl.saved_policy import find_runs

        runs = find_runs(self.run)
        if self.arm and self.arm in runs:
            return runs[self.arm]
        if len(runs) > 1 or (self.arm and runs):
            raise UsageError(f"which arm? Give --arm with one of {', '.join(runs)}.")
        return next(iter(runs.values()), self.run)
