"""The last observations of episodes that ended, in the `info["final_obs"]` of a vector environment.

Gymnasium's vector environments have an array of objects there, one for each environment. Others, such as
those of the Arcade Learning Environment, have one array for all environments, or a dictionary of arrays.
"""

from collections.abc import Callable
from typing import Any

import numpy as np


def last_observations(info: dict[str, Any]) -> tuple[np.ndarray, Any]:
    """Return the environments whose episodes ended, and their last observations as one batch.

    Args:
        info: the info of a step, with `final_obs`.
    """
    ended, final = np.flatnonzero(info["_final_obs"]), info["final_obs"]
    if isinstance(final, dict):
        return ended, {key: values[ended] for key, values in final.items() if not _is_mask(key, final)}
    return ended, final[ended] if _is_one_array(final) else _stack([final[i] for i in ended])


def replace_last_observations(info: dict[str, Any], change: Callable[[Any, np.ndarray], Any]) -> None:
    """Change the last observations, and keep the layout of `final_obs`.

    Args:
        info: the info of a step, with `final_obs`; its entry is replaced.
        change: from the last observations, and the environments that they belong to, to the new ones.
    """
    ended, last = last_observations(info)
    final, shown = info["final_obs"], change(last, ended)
    if isinstance(final, np.ndarray) and not _is_one_array(final):
        for row, i in enumerate(ended):
            final[i] = _row(shown, row)
        return
    num = len(info["_final_obs"])
    info["final_obs"] = (
        {key: _spread(values, ended, num) for key, values in shown.items()}
        if isinstance(shown, dict)
        else _spread(shown, ended, num)
    )


def last_observation(final: Any, env: int) -> Any:
    """Return the last observation of one environment from `final_obs`."""
    if isinstance(final, dict):
        return {key: values[env] for key, values in final.items() if not _is_mask(key, final)}
    return final[env]


def _is_one_array(final: Any) -> bool:
    return isinstance(final, np.ndarray) and final.dtype != object


def _is_mask(key: str, final: dict[str, Any]) -> bool:
    return key.startswith("_") and key[1:] in final


def _stack(rows: list[Any]) -> Any:
    if isinstance(rows[0], dict):
        return {key: _stack([row[key] for row in rows]) for key in rows[0]}
    return np.stack(rows)


def _row(batch: Any, row: int) -> Any:
    return (
        {key: _row(values, row) for key, values in batch.items()} if isinstance(batch, dict) else batch[row]
    )


def _spread(values: np.ndarray, ended: np.ndarray, num: int) -> np.ndarray:
    """An array with a row for each environment; environments whose episodes go on have zeros."""
    spread = np.zeros((num, *values.shape[1:]), values.dtype)
    spread[ended] = values
    return spread
