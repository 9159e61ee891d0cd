"""Baselines of pairs that share their left view, as the command line gives them."""

from __future__ import annotations

from depthcli.core.errors import ConfigError


def baselines_of(text: str, n_wanted: int, noun: str) -> list[float]:
    """Return the baselines that the command line gives; ConfigError where there is not one for each map or view.

    Parameters
    ----------
    noun : what there is one for each of, for messages
    """
    from depthcli.api.judging import check_baselines

    words = text.split(",")
    if len(words) != n_wanted:
        raise ConfigError(f"--baselines: want one for each of the {n_wanted} {noun} (got {text!r})")
    try:
        lengths = [float(word) for word in words]
    except ValueError:
        raise ConfigError(f"--baselines: want numbers such as 0.1,0.3 (got {text!r})") from None
    check_baselines(lengths)
    return lengths
