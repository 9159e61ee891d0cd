"""Outputs of an evaluation for people: tables, ``report.md``, the page ``report.html``, the contact sheet.

``tables`` arranges the numbers and writes report.md, ``terms`` explains their headings, ``plots`` draws them. The
page is one file to look at maps, errors and numbers, readable without a network. ``page`` collects the scenes while
they are evaluated and fills the template ``page.html`` at the end; start there. ``scene_view`` chooses the shown
parts of a scene: its maps (images, or slices of volumes) and small pictures. ``without_truth`` shows scenes without
ground truth in a table with the run's own figures, the worst scene first. ``packing`` writes and embeds the maps, as
16-bit codes in base64. In the browser ``page.js`` sorts tables and unpacks maps, and ``viewer.js`` draws them. This
package uses only the interface ``Protocol`` of ``depthcli.evaluation``, and no protocol by its name.

``contact_sheet`` is a picture of its own: image, maps and errors of the scenes that differ most, side by side.
"""
