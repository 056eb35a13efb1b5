"""Tables of the job database, as of the newest migration.

A job asks for one image and points to a film; a film owns its chunks, attempts and merged prefix,
and may serve several jobs. Files are content-addressed `artifact` rows, kept while a `reference`
row names them. Times are Unix seconds; JSON columns hold text. Nothing here is SQLite-specific.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    false,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite numbers rows itself only for a column of type INTEGER.
Serial = BigInteger().with_variant(Integer, "sqlite")

film = Table(
    "film",
    metadata,
    Column("id", Serial, primary_key=True, autoincrement=True),
    Column("film_key", String(64), nullable=False, unique=True),
    Column("geometry_key", String(64), nullable=False),
    Column("scene", Text, nullable=False),  # JSON without output and stop rule; "": see plan, cell
    Column("assets", Text, nullable=False),  # JSON {name: sha256}, pinned at submission
    Column("width", Integer, nullable=False),
    Column("height", Integer, nullable=False),
    Column("replicates", Integer, nullable=False),
    Column("state", String(16), nullable=False),  # open | failed
    Column("whole", Boolean, nullable=False, default=False),  # small: rendered by one child at once
    Column("plan", String(64)),  # of a small film of a sweep: the artifact that holds the sweep,
    Column("cell", Integer),  # and which of its cells the scene is
    Column("claim_token", Serial),  # attempt that holds the whole film
    Column("tries", Integer, nullable=False, default=0),  # crashes while it was rendered whole
    Column("losses", Integer, nullable=False, default=0),  # kills from outside meanwhile
    Column("prefix_record", Integer, nullable=False, default=0),  # place of the film in its file
    Column("prefix_chunks", Integer, nullable=False, default=0),  # plan indices [0, n) are merged
    Column("prefix_spp", BigInteger, nullable=False, default=0),
    Column("pixel_samples", BigInteger, nullable=False, default=0),  # accepted, merged or not
    Column("seconds", Float, nullable=False, default=0.0),  # thread seconds / slots, accepted
    Column("relmse", Float),
    Column("relmse_lower", Float),
    Column("relmse_upper", Float),
    Column("chunks_rendered", BigInteger, nullable=False, default=0),  # accepted completions
    Column("reports_superseded", Integer, nullable=False, default=0),
    Column("created", Float, nullable=False),
    Column("used", Float, nullable=False, server_default="0"),  # the longest unused goes first
    Index("ix_film_used", "used"),
    Index("ix_film_claim_token", "claim_token"),
)

sweep = Table(
    "sweep",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("label", Text, nullable=False),
    Column("mode", String(16), nullable=False),
    Column("axes", Text, nullable=False),
    Column("base", Text, nullable=False),
    Column("cells", Integer, nullable=False),
    Column("expanded", Integer, nullable=False, default=0),  # cells [0, n) have jobs
    Column("cancelled", Boolean, nullable=False, default=False),  # the others never get one
    Column("paused", Boolean, nullable=False, default=False),  # nor while this lasts
    Column("priority", Integer, nullable=False, default=50),
    Column("request", Text, nullable=False, default="{}"),  # JSON that makes jobs of cells
    Column("columns", Integer, nullable=False),
    Column("baseline", Integer),  # cell that others are compared with
    Column("budget", Text),  # JSON: seconds that all cells share, target_error of each
    Column("budget_spent_s", Float, nullable=False, server_default="0"),
    Column("budget_closed", Boolean, nullable=False, server_default=false()),  # no more is rendered
    Column("created", Float, nullable=False),
    Column("finished", Float),
    Column("blockers", Integer, nullable=False, server_default="0"),  # as `job.blockers`
    Column("pinned", Boolean, nullable=False, server_default=false()),
    Column("owner", String(16)),  # id of the API key that submitted it
    Column("samples", Float, nullable=False, server_default="0"),  # asked for; with an owner
    Column("deleted", Boolean, nullable=False, server_default=false()),  # hidden; rows still go
)

job = Table(
    "job",
    metadata,
    Column("id", String(36), primary_key=True),  # UUIDv7: sorts by time
    Column("film_id", Serial, ForeignKey("film.id"), nullable=False, index=True),
    Column("sweep_id", String(36), ForeignKey("sweep.id")),
    Column("cell", Integer),
    Column("parameters", Text, nullable=False),
    Column("state", String(16), nullable=False),
    Column("priority", Integer, nullable=False),
    Column("stop", Text, nullable=False),
    Column("spp_cap", BigInteger, nullable=False),  # no sample beyond this boundary is wanted
    Column("output", Text, nullable=False),
    Column("film_record", Integer, nullable=False, default=0),  # place in the job's film file
    Column("label", Text, nullable=False),
    Column("cached", Boolean, nullable=False, default=False),
    Column("prefix_spp_at_submit", BigInteger, nullable=False, default=0),
    Column("created", Float, nullable=False),
    Column("started", Float),
    Column("finished", Float),
    Column("target_share", Float),  # of the samples to target_error, at its newest look
    # Set when the stop rule fired; the job is still running until its images are made.
    Column("ended_spp", BigInteger),
    Column("ended_seconds", Float),
    Column("ended_relmse", Float),
    Column("ended_relmse_lower", Float),
    Column("ended_relmse_upper", Float),
    Column("stop_reason", String(32)),
    Column("error_code", String(64)),
    Column("error_message", Text),
    Column("error_pointer", Text),
    Column("error_log", Text),
    Column("rank", Float, nullable=False, server_default="0"),  # place in the queue: `queue_rank`
    Column("queued", Float, nullable=False, server_default="0"),  # since when it has aged
    Column("deadline", Float),  # Unix seconds
    Column("blockers", Integer, nullable=False, server_default="0"),  # dependencies yet unmet
    Column("attempt", Integer, nullable=False, server_default="1"),  # rises with every requeue
    Column("owner", String(16)),  # id of the API key that submitted it
    Column("samples", Float, nullable=False, server_default="0"),  # asked for; with an owner
    Index("ix_job_queue", "state", "rank", "id"),
    Index("ix_job_deadline", "deadline"),
    Column("pinned", Boolean, nullable=False, server_default=false()),  # kept whatever its age
    Index("ix_job_finished", "finished"),
    Index("ix_job_sweep", "sweep_id", "cell"),
    Index("ix_job_sweep_state", "sweep_id", "state"),
)

# What a job or sweep (`waiter`) waits for: a job or sweep that was there before it.
dependency = Table(
    "dependency",
    metadata,
    Column("waiter", String(36), primary_key=True),
    Column("needs", String(36), primary_key=True, index=True),
)

# How the attempts of a requeued job ended before the one of its row.
job_history = Table(
    "job_history",
    metadata,
    Column("job_id", String(36), ForeignKey("job.id"), primary_key=True),
    Column("attempt", Integer, primary_key=True, autoincrement=False),
    Column("state", String(16), nullable=False),
    Column("queued", Float, nullable=False),
    Column("started", Float),
    Column("finished", Float),
    Column("error_code", String(64)),
    Column("error_message", Text),
    Column("error_pointer", Text),
    Column("error_log", Text),
)

chunk = Table(
    "chunk",
    metadata,
    Column("film_id", Serial, ForeignKey("film.id"), primary_key=True),
    Column("idx", Integer, primary_key=True, autoincrement=False),  # index in the film's plan
    Column("state", String(16), nullable=False),  # missing | claimed | done
    Column("token", Serial, nullable=False),  # attempt that holds or made it
    Column("tries", Integer, nullable=False, default=0),  # crashes while it was being rendered
    Column("losses", Integer, nullable=False, default=0),  # kills from outside meanwhile
)

attempt = Table(
    "attempt",
    metadata,
    Column("id", Serial, primary_key=True, autoincrement=True),  # the fencing token
    Column("film_id", Serial, ForeignKey("film.id"), index=True),  # null: a batch of small films
    Column("instance_id", String(36), nullable=False),
    Column("child", Integer, nullable=False),  # pid
    Column("chunks", Integer, nullable=False),
    Column("state", String(16), nullable=False),  # running|done|merged|failed|lost|void|cancelled
    Column("digest", String(64)),
    Column("seconds", Float),
    Column("error_class", String(64)),
    Column("error_message", Text),
    Column("log_tail", Text),
    Column("created", Float, nullable=False),
    Column("ended", Float),
    Column("lease_until", Float, nullable=False),
    Index("ix_attempt_state", "state"),
)

artifact = Table(
    "artifact",
    metadata,
    Column("digest", String(64), primary_key=True),
    Column("size", BigInteger, nullable=False),
    Column("state", String(16), nullable=False),  # live | deleting
    Column("created", Float, nullable=False),
    Index("ix_artifact_state", "state"),
)

reference = Table(
    "reference",
    metadata,
    Column("owner", String(16), primary_key=True),  # job | film | sweep | attempt
    Column("owner_id", String(36), primary_key=True),
    Column("kind", String(32), primary_key=True),
    Column("digest", String(64), ForeignKey("artifact.digest"), nullable=False, index=True),
)

event = Table(
    "event",
    metadata,
    Column("seq", Serial, primary_key=True, autoincrement=True),
    Column("time", Float, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("job_id", String(36), index=True),
    Column("sweep_id", String(36), index=True),
    Column("data", Text, nullable=False),
    sqlite_autoincrement=True,  # a number is never used again
)

idempotency = Table(
    "idempotency",
    metadata,
    Column("key", String(255), primary_key=True),
    Column("body_hash", String(64), nullable=False),
    Column("kind", String(16), nullable=False),  # job | sweep
    Column("target_id", String(36), nullable=False, index=True),
    Column("created", Float, nullable=False),
)

instance = Table(
    "instance",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("pid", Integer, nullable=False),
    Column("started", Float, nullable=False),
    Column("ended", Float),
    Column("chunks_present", Integer, nullable=False, default=0),  # done at the start, unmerged
    Column("chunks_voided", Integer, nullable=False, default=0),  # in flight when the last died
)

api_key = Table(
    "api_key",
    metadata,
    Column("id", String(16), primary_key=True),  # no secret: names the key
    Column("name", Text, nullable=False),
    Column("scope", String(16), nullable=False),  # read | submit | admin
    Column("digest", String(64), nullable=False),  # SHA-256 of the key
    Column("created", Float, nullable=False),
    Column("expires", Float),
    Column("revoked", Float),
)

webhook = Table(
    "webhook",
    metadata,
    Column("id", String(36), primary_key=True),
    Column("url", Text, nullable=False),
    Column("kinds", Text, nullable=False),  # JSON list of event kinds
    Column("cells", Boolean, nullable=False),  # events of cells of sweeps too
    Column("secret", Text, nullable=False),  # signs; the receiver has it too
    Column("created", Float, nullable=False),
    Column("delivered", Integer, nullable=False, server_default="0"),
    Column("given_up", Integer, nullable=False, server_default="0"),
    Column("error", Text),  # of the newest attempt
    Column("disabled", Text),  # why nothing is sent any more
)

# The outbox: one event for one webhook, until it is delivered or given up.
delivery = Table(
    "delivery",
    metadata,
    Column("id", String(40), primary_key=True),  # the receiver sees it: the same in every attempt
    Column("webhook_id", String(36), ForeignKey("webhook.id"), nullable=False, index=True),
    Column("body", Text, nullable=False),
    Column("tries", Integer, nullable=False, default=0),
    Column("due", Float, nullable=False, index=True),
    Column("held", Boolean, nullable=False, server_default=false()),  # an attempt is under way
    Column("created", Float, nullable=False),
)
