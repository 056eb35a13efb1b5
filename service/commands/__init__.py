"""The subcommands of `matiere`: name -> (module:function in this package, one line of help).

A module is imported only when its command is asked for.
"""

COMMANDS: dict[str, tuple[str, str]] = {
    "render": ("render:render", "Render a scene to PNG, JPEG or EXR, with its error."),
    "replay": ("replay:replay", "Print the path of one sample in words: where a speck comes from."),
    "sweep": ("sweep:sweep", "Render every variant of a sweep and a contact sheet."),
    "fetch": ("fetch:fetch", "Bring files of a job or of some cells of a sweep."),
    "check": ("check:check", "Test a material at its exact parameters: the stability report."),
    "compare": ("compare:compare", "Tell how two films or nights differ, and what is noise."),
    "night": ("night:night", "Export the night of a sweep, to compare it later."),
    "nightly": ("nightly:nightly", "Run sweeps every night and tell what really changed."),
    "serve": ("serve:serve", "Serve the HTTP API: take jobs and sweeps, render them."),
    "submit": ("submit:submit", "Send a scene to a running service and fetch the image."),
    "watch": ("watch:watch", "Show how a job or sweep goes on, to its end."),
    "pause": ("steer:pause", "Hold jobs or sweeps back; their samples are kept."),
    "resume": ("steer:resume", "Let paused jobs or sweeps go on."),
    "cancel": ("steer:cancel", "Cancel jobs or sweeps."),
    "delete": ("steer:delete", "Remove jobs or sweeps with their results."),
    "requeue": ("steer:requeue", "Try again what failed, expired or was cancelled."),
    "priority": ("steer:priority", "Change the priority of a job or sweep."),
    "du": ("storage:du", "Print what the data directory holds, and its limits."),
    "gc": ("storage:gc", "Remove old results, unused films and files nobody names."),
    "pin": ("storage:pin", "Keep jobs or sweeps whatever their age."),
    "unpin": ("storage:unpin", "Keep jobs or sweeps no longer than others."),
    "backup": ("storage:backup", "Copy the data directory while the service runs."),
    "key": ("key:key", "Make, list, rotate and revoke API keys."),
    "schema": ("schema:schema", "Print the JSON Schema of scenes."),
    "info": ("info:info", "Print versions, Embree, instruction set and threads."),
    "config": ("config:config", "Print every setting and where its value came from."),
}
