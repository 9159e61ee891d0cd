"""Device implementations of the pipelines for devices: ``run(method, pair, max_disparity, device)``."""
