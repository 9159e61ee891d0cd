"""Scenes as arrays: what :mod:`depthcli.data.generated` computes."""
