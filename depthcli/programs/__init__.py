"""Programs of others as methods: files in, a map out; every scene in a scratch folder of its own.

| module | holds |
|---|---|
| ``stereo.command``, ``kinect.command``, ``transparent.command``, ``registration.command`` | any program |
| ``stereo.middlebury_sdk`` | the pipeline for programs in the form of the Middlebury SDK |
| ``depth`` | what the two for depth maps share |
| ``maps`` | images for programs, and formats of the maps that they write |
| ``program`` | what all configs share: words with placeholders, scratch folders |
| ``process`` | one program as a process: its time, memory and output, all that it starts ended with it |
| ``_supervisor`` | the script that watches over it, in a process of its own |
| ``scene`` | name and memory of the scene that is computed |

Methods may not open files, so these pipelines lie here and not in the families of ``depthcli.methods``, which get them
by :func:`depthcli.core.registry.provide`. Whoever reads configs imports this package.
"""

from depthcli.core.registry import provide

provide(
    "depthcli.methods.stereo.pipeline",
    "depthcli.programs.stereo.command",
    "depthcli.programs.stereo.middlebury_sdk",
)
provide("depthcli.methods.kinect.pipeline", "depthcli.programs.kinect.command")
provide("depthcli.methods.transparent.pipeline", "depthcli.programs.transparent.command")
provide("depthcli.methods.registration.pipeline", "depthcli.programs.registration.command")
