import numpy as np
import pytest
import scipy.stats

from planspace.errors import PlanspaceError
from planspace.rl.config import TrainConfig
from planspace.study import stats
from planspace.study.design import Arm, Claim
from planspace.study.results import PoliciesResult
from planspace.study.stats import FAILS, HOLDS, OPEN, Scores, judge
from planspace.study.unit import PolicyUnit


def scores(final: list[float], *, first: int = 0, num_embeddings: int = 0) -> Scores:
    """Scores with four rows of 100,000 steps; all rows have the final return."""
    steps = 100_000 * np.arange(1, 5)
    return Scores(tuple(range(first, first + len(final))), steps, np.tile(final, (4, 1)), num_embeddings)


def test_the_final_return_is_the_mean_over_the_last_steps() -> None:
    # 1 M steps in rows of five iterations: the last 200,000 steps are ten rows
    steps = 20_000 * np.arange(1, 51)
    returns = np.arange(50.0)[:, None]
    long = Scores((0,), steps, returns, 0)
    assert stats.final(long) == pytest.approx(44.5)  # mean of 40 .. 49
    assert stats.early(long) == pytest.approx(5.5)  # rows until 250,000 steps: 0 .. 11
    assert stats.whole(long) == pytest.approx(24.5)
    short = Scores((0,), np.array([4000, 8000, 12000]), np.array([[1.0], [2.0], [6.0]]), 0)
    assert stats.final(short) == 6.0 and stats.early(short) == 1.0
    assert stats.whole(short) == pytest.approx(3.0)
    uneven = Scores((0,), np.array([20_000, 24_000]), np.array([[1.0], [7.0]]), 0)
    assert stats.whole(uneven) == pytest.approx(2.0)  # 20,000 steps of 1 and 4,000 of 7


def test_steps_to_a_level_use_the_mean_of_two_rows() -> None:
    steps = np.array([10, 20, 30, 40])
    returns = np.array([[0.0, 9.0], [8.0, 0.0], [4.0, 0.0], [9.0, 0.0]])
    found = stats.steps_to(Scores((0, 1), steps, returns, 0), 5.0)
    assert found[0] == 30  # (8 + 4) / 2 = 6; the mean at the earlier peak is (0 + 8) / 2 = 4
    assert np.isinf(found[1])


def test_interquartile_mean_is_the_mean_of_the_middle_half() -> None:
    x = np.array([-1000.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1000.0])
    assert stats.iqm(x) == 3.5  # mean of 2, 3, 4, 5
    assert stats.iqm(np.stack([x, x + 1])).tolist() == [3.5, 4.5]
    rng = np.random.default_rng(0)
    for _ in range(20):
        y = rng.normal(size=int(rng.integers(4, 40)))
        assert stats.iqm(y) == scipy.stats.trim_mean(y, 0.25)


def test_the_bootstrap_over_tasks_draws_seeds_within_each_task() -> None:
    tasks = [np.full(15, 0.0), np.full(15, 1.0)]
    number, (low, high) = stats.iqm_over_tasks(tasks)
    assert number == low == high == 0.5  # if drawn across tasks, it would vary
    _, (low, high) = stats.iqm_over_tasks([np.arange(15.0), np.arange(15.0) + 1])
    assert low < 7.5 < high


def test_probability_of_improvement_counts_pairs() -> None:
    number, (low, high) = stats.probability_of_improvement(np.array([1.0, 3.0]), np.array([1.0, 2.0]))
    assert number == 0.625  # a tie, a loss, two wins: (0.5 + 0 + 1 + 1) / 4
    assert 0.0 <= low <= number <= high <= 1.0
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=15), rng.normal(size=15)
    expected = scipy.stats.mannwhitneyu(x, y).statistic / (15 * 15)
    assert stats.probability_of_improvement(x, y)[0] == pytest.approx(expected)


def test_variance_components_of_a_hand_worked_table() -> None:
    # embedding 0 has the policies 1, 3; embedding 1 has 7, 9. Variance within: 2. Variance of the means
    # 2 and 8: 18; minus 2 / 2: 17
    table = scores([1.0, 7.0, 3.0, 9.0], num_embeddings=2)
    found = stats.variance_components(table, stats.final(table))
    assert found == pytest.approx((np.sqrt(17.0), np.sqrt(2.0)))
    single = scores([1.0, 2.0], num_embeddings=1)
    assert stats.variance_components(single, stats.final(single)) is None


def test_a_profile_falls_from_one_to_zero() -> None:
    fractions = stats.profile(np.array([1.0, 2.0, 2.0, 4.0]), np.array([0.0, 1.0, 3.0, 4.0]))
    assert fractions.tolist() == [1.0, 0.75, 0.25, 0.0]


@pytest.mark.parametrize("num_embeddings", [0, 5])
def test_intervals_have_about_the_nominal_coverage(num_embeddings: int) -> None:
    rng, hits, trials = np.random.default_rng(0), 0, 400
    for _ in range(trials):
        shift = rng.normal(size=max(num_embeddings, 1))
        x = rng.normal(size=15) + (shift[np.arange(15) % num_embeddings] if num_embeddings else 0.0)
        low, high = stats.interval(scores(x.tolist(), num_embeddings=num_embeddings), stats.mean, x)
        hits += low < 0 < high
    assert 0.92 < hits / trials < 0.99
    # treating seeds as independent gives intervals that are too narrow
    if num_embeddings:
        naive = 0
        for _ in range(trials):
            shift = rng.normal(size=num_embeddings)
            x = rng.normal(size=15) + shift[np.arange(15) % num_embeddings]
            low, high = stats.interval(scores(x.tolist()), stats.mean, x)
            naive += low < 0 < high
        assert naive / trials < 0.85


RISE = [float(x) for x in range(15)]


@pytest.mark.parametrize(
    ("expects", "margin", "shift", "verdict"),
    [
        ("more", 0.0, 1.0, HOLDS),
        ("more", 0.0, -1.0, FAILS),
        ("less", 0.0, -1.0, HOLDS),
        ("less", 0.0, 1.0, FAILS),
        ("same", 2.0, 1.0, HOLDS),
        ("same", 0.5, 1.0, FAILS),
        ("more", 0.0, 0.0, OPEN),
    ],
)
def test_verdicts_follow_the_interval_of_paired_differences(
    expects: str, margin: float, shift: float, verdict: str
) -> None:
    # seeds differ by up to 14, arms only by the shift: only a paired comparison detects it
    noise = np.linspace(-0.1, 0.1, 15)  # of mean 0
    arm, other = scores([x + shift + n for x, n in zip(RISE, noise, strict=True)]), scores(RISE)
    claim = Claim("", "", "final", "a", "b", expects, margin)
    found = judge(claim, arm, other)
    assert found.verdict == verdict and found.seeds == 15
    assert found.number == pytest.approx(shift)


def test_a_claim_about_one_arm_is_judged_by_its_margin() -> None:
    claim = Claim("", "", "final", "a", "", margin=5.0)
    assert judge(claim, scores([6.0] * 10), None).verdict == HOLDS
    assert judge(claim, scores([4.0] * 10), None).verdict == FAILS


@pytest.mark.parametrize(("expects", "sign"), [("more", 1.0), ("less", -1.0)])
def test_a_claim_with_a_margin_needs_a_difference_above_it(expects: str, sign: float) -> None:
    claim = Claim("", "", "final", "a", "b", expects, 5.0)
    assert judge(claim, scores([6.0 * sign] * 10), scores([0.0] * 10)).verdict == HOLDS
    assert judge(claim, scores([4.0 * sign] * 10), scores([0.0] * 10)).verdict == FAILS


def test_the_smaller_number_of_embeddings_is_used() -> None:
    rng, hits, trials = np.random.default_rng(0), 0, 300
    claim = Claim("", "", "final", "a", "b")
    for _ in range(trials):
        x = rng.normal(size=15) + rng.normal(size=5)[np.arange(15) % 5]
        y = rng.normal(size=15) + rng.normal(size=3)[np.arange(15) % 3]
        arm, other = scores(x.tolist(), num_embeddings=5), scores(y.tolist(), num_embeddings=3)
        low, high = judge(claim, arm, other).interval
        hits += low < 0 < high
    assert hits / trials > 0.93


def test_a_smaller_spread_gives_a_larger_number() -> None:
    wide, narrow = scores(RISE), scores([x / 4 for x in RISE])
    claim = Claim("", "", "spread", "a", "b")
    found = judge(claim, narrow, wide)
    assert found.number == pytest.approx(np.log(4.0)) and found.verdict == HOLDS
    assert judge(claim, wide, narrow).verdict == FAILS
    ratio, (low, high) = stats.log_std_ratio(narrow, wide)
    assert low <= ratio <= high and ratio == pytest.approx(np.log(4.0))


def test_few_shared_seeds_leave_a_claim_open() -> None:
    claim = Claim("", "", "final", "a", "b")
    assert judge(claim, scores([9.0] * 4), scores([0.0] * 4)).verdict == OPEN
    assert judge(claim, scores([9.0] * 9), scores([0.0] * 9, first=9)).verdict == OPEN
    partly = judge(claim, scores([9.0] * 9), scores([0.0] * 9, first=3))
    assert partly.verdict == HOLDS and partly.seeds == 6


def test_the_best_case_is_the_mean_of_the_two_best_seeds() -> None:
    assert stats.best(np.array([1.0, 9.0, 5.0, 7.0])) == 8.0


def test_blocks_are_merged_in_the_order_of_their_seeds() -> None:
    arm = Arm("panel", "arm", (PolicyUnit("cartpole", TrainConfig()),))

    def block(seeds: list[int], steps: tuple[int, ...] = (4000,)) -> PoliciesResult:
        returns = tuple([float(seed) for seed in seeds] for _ in steps)
        return PoliciesResult(tuple(seeds), steps, returns, (False,) * len(seeds))

    merged = Scores.of(arm, [block([5, 6]), block([0, 1])])
    assert merged.seeds == (0, 1, 5, 6) and merged.returns.tolist() == [[0.0, 1.0, 5.0, 6.0]]
    with pytest.raises(PlanspaceError, match="the blocks of panel/arm do not fit together"):
        Scores.of(arm, [block([0]), block([0])])
    with pytest.raises(PlanspaceError, match="do not fit together"):
        Scores.of(arm, [block([0]), block([1], (4000, 8000))])


def test_a_single_seed_has_no_interval() -> None:
    one, two = np.array([1.0]), np.array([2.0])
    assert stats.probability_of_improvement(one, two) == (0.0, (0.0, 1.0))
    assert stats.iqm_over_tasks([one, two]) == (1.5, (1.5, 1.5))
