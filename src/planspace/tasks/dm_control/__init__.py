"""Tasks of DeepMind Control (extra `robots`), one module per domain; `suite` finds them by name.

The models are those of the installed dm_control. Their observations, rewards, control steps and starts are
defined here for batches of states, and a test compares each task with dm_control's own, step by step.
"""
