"""What people read of an evaluation: tables, ``report.md``, the page ``report.html``, the contact sheet.

``tables`` arranges the numbers, ``terms`` explains their headings, ``plots`` draws them, ``document`` writes report.md.
The page is one file to look at maps, errors and numbers, readable without a network.
``page`` collects the scenes while they are evaluated and fills the template ``page.html`` at the end; start there.
``scene_view`` chooses the parts of a scene that are shown, its maps (images, or slices of volumes) and small pictures;
``without_truth`` shows a run's scenes without ground truth: a table of the run's own figures of its maps,
the worst first. ``packing`` writes and embeds the maps, as 16-bit codes in base64. In the browser
``page.js`` sorts tables and unpacks maps, ``viewer.js`` draws them. The room knows no protocol by name: all that it
uses is the interface ``Protocol`` of ``depthcli.evaluation``.

``contact_sheet`` is a picture of its own: image, maps and errors of the scenes that differ most, side by side.
"""
