"""A fixture of the tests of plug-ins."""

from __future__ import annotations

import sys

import pytest

from depthcli.core import plugins, registry
from depthcli.evaluation import protocols


@pytest.fixture
def forget_plugins(monkeypatch: pytest.MonkeyPatch):
    """Leave no plug-in behind for other tests."""
    for module, name in ((plugins, "_file_plugins"), (plugins, "_read_files"), (registry, "_plugin_by_class")):
        monkeypatch.setattr(module, name, {})
    monkeypatch.setenv("DEPTHCLI_PLUGIN_FILES", "")
    plugins._installed.cache_clear()
    plugins._is_any_installed.cache_clear()
    protocols.load.cache_clear()
    yield
    protocols.load.cache_clear()
    plugins._installed.cache_clear()
    plugins._is_any_installed.cache_clear()
    for name in [name for name in sys.modules if name.startswith(("depthcli_plugin_", "strange_"))]:
        del sys.modules[name]
