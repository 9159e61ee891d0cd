"""Large pairs, matched in tiles: parts of the images, each over its own disparities.

| module | what it holds |
|---|---|
| ``coarse_to_fine`` | ``match_in_tiles``, where to start: maps of the pair at smaller sizes limit what tiles search |
| ``plan`` | ``Tile``, ``Candidates`` (disparities by block of 16 x 16 pixels) -> the tiles that fit into ``Memory`` |
| ``tile_by_tile`` | tiles -> map: by the costs of the tiles (``match_by_costs``), or every tile as a pair of its own |
| ``winners`` | ``TiledWinners``: the cheapest disparities of both views, collected from the costs of all tiles |
"""
