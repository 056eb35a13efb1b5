"""Run migrations on the connection that `matiere.jobs.store.database` hands over."""

from alembic import context

from matiere.jobs.store.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,
    transactional_ddl=True,  # the caller's transaction holds the whole upgrade
)
context.run_migrations()
