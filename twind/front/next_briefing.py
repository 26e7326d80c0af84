"""Next briefing after a change of settings or files. Pure; for the front and for readers of files."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec

from twind.briefing import Briefing
from twind.config import config_files, file_changes, reload_plan
from twind.config.config_files import ConfigSources, LoadedConfig

BY_CLIENT = "SetParameters"  # where such a value comes from


def with_files(briefing: Briefing, sources: ConfigSources, then: LoadedConfig) -> Briefing:
    """Return the next briefing with the present content of the files; limits and gains stay as they are."""
    return msgspec.structs.replace(
        briefing,
        parameters=then.settings.parameters(),
        log_level=then.settings.log_level,
        files=dict(then.files),
        texts=file_changes.texts(then.files, briefing.texts),
        described=config_files.pack(sources, then),
        generation=briefing.generation + 1,
    )


def with_settings(briefing: Briefing, changes: Mapping[str, Any]) -> Briefing:
    """The next briefing, with settings changed by a client's word. Raises InvalidInput, ValueError."""
    sources, old = config_files.unpacked(briefing.described)
    then = reload_plan.with_changes(old, changes)
    named = dict.fromkeys((key.rpartition(".")[2] for key in changes), BY_CLIENT)
    settings = replace(then.settings, origins={**then.settings.origins, **named})
    return with_files(briefing, sources, replace(then, settings=settings))
