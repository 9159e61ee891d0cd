"""Scenes as arrays: what :mod:`depthcli.simulate` computes."""
