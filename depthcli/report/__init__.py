"""``report.html``, the page of an evaluation: one file to look at maps, errors and numbers, readable without a network.

``page`` collects the scenes while they are evaluated and fills the template ``page.html`` at the end; start there.
``scene_view`` makes what the page holds of one scene: its maps (images, or slices of volumes), packed by ``packing`` as
16-bit codes in base64, and small pictures in the colors of the page. In the browser ``page.js`` sorts tables and
unpacks maps, ``viewer.js`` draws them. The room knows no protocol by name: all that it uses is the interface
``Protocol`` of ``depthcli.evaluation``. Scenes of a run that have no ground truth get a table of what the run says of
its own maps, the worst first.

``contact_sheet`` is a picture of its own: image, maps and errors of the first scenes, side by side.
"""
