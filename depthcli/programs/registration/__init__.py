"""Programs that estimate the errors of registrations, as pipelines of ``register-confidence``."""
