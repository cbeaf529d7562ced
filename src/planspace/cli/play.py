"""`planspace play`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.errors import UsageError


@dataclass(frozen=True)
class Play:
    """Watch a trained policy: deterministic episodes, their returns, and a film if asked for."""

    run: Positional[Annotated[Path, arg(metavar="RUN")]]
    """The folder of a `planspace train`."""
    seed: Annotated[str, arg(metavar="best|N")] = "best"
    """Which of its seeds; best: the one that earned most in the last evaluation."""
    episodes: Annotated[int, arg(metavar="N")] = 10
    """How many episodes."""
    start_seed: int = 1000
    """The seed of the first episode's start; the others follow it."""
    video: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Film them: FILE.gif, or FILE.mp4 (extra `video`)."""

    def __call__(self) -> None:
        """Plays, prints the returns and writes the film."""
        from planspace.demos.render import FilmConfig, check_film, render_demos
        from planspace.rl.play import play
        from planspace.rl.saved_policy import load_policy

        if self.episodes < 1 or self.start_seed < 0:
            raise UsageError("--episodes must be at least 1, --start-seed at least 0.")
        if self.seed != "best" and not (self.seed.isascii() and self.seed.isdigit()):
            raise UsageError(f"--seed is best or a number, got {self.seed!r}.")
        if self.video is not None:
            check_film(self.video)
        policy = load_policy(self.run, "best" if self.seed == "best" else int(self.seed))
        returns, demos = play(policy, self.episodes, self.start_seed)
        print(f"seed {policy.seed}, {len(returns)} episodes of {policy.about['env_id']}")
        print(f"return: mean {returns.mean():.1f}, worst {returns.min():.1f}, best {returns.max():.1f}")
        if self.video is not None:
            render_demos(demos, self.video, FilmConfig())
            print(self.video)
