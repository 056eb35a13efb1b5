"""Rendering beyond one machine, through Ray: `pip install 'matiere[ray]'`.

    scheduler -pipe-> driver (a child, the only Ray driver) -tasks-> nodes -pipe-> render child

`member` is the driver as the scheduler sees it, `driver` the process, `node` what runs in a task.
"""
