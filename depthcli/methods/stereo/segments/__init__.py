"""Segment-based stereo (thesis, chapter 2): matching costs in, a map with one plane per segment out.

| module | step, with its part of the config |
|---|---|
| ``steps`` | the data flow of all steps, where to start; restoration of surfaces that are not planar; results |
| ``ranges`` | matched key points -> disparities that their segment may have |
| ``first_estimate`` | costs -> first disparities and trusted pixels -> segments, cut if they are not planar |
| ``planes`` | segments -> candidate planes -> energies -> one plane for every segment, by graph cuts |
"""
