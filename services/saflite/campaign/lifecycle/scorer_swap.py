"""Changing the scorer while the campaign runs: warm the new one, flip between batches, or roll back."""

from __future__ import annotations

from saflite.campaign.engine.core import Core
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import WarmKey
from saflite.contract.control import Control
from saflite.contract.events import WATCHES_ONLY, ScorerChanged
from saflite.contract.names import LABEL_CHARS_MAX
from saflite.contract.work import WarmResult


class Scorers:
    """Which model decides, which only watch, and which change is under way."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.model = core.campaign.scorer.model
        self.shadow = core.campaign.scorer.shadow
        self.pending: dict[WarmKey, tuple[bool, tuple[str, ...]]] = {}  # warm task: (deciding?, models to be)
        self._count = 0

    def is_under_way(self, control: Control) -> bool:
        """Whether the very change that is ordered is under way: who got no answer orders it again."""
        decides = control.verb == "scorer"
        models = (control.text,) if decides else tuple(model for model in control.text.split(",") if model)
        return control.verb in ("scorer", "shadow") and (decides, models) in self.pending.values()

    def swap(self, model: str) -> None:
        """Begin to change the deciding model; a change under way to another one is dropped."""
        for key in [key for key, (decides, _) in self.pending.items() if decides]:
            self._drop(key, "another change was ordered")
        self._warm(model, True, (model,))

    def watch(self, models: tuple[str, ...]) -> None:
        """Begin to change the models that only watch: those not watching yet are warmed first."""
        for key in [key for key, (decides, _) in self.pending.items() if not decides]:
            self._drop(key, "another change was ordered")
        new = [model for model in models if model not in (*self.shadow, self.model)]
        if not new:
            self.shadow = models
        for model in new:
            self._warm(model, False, models)

    def _warm(self, model: str, decides: bool, models: tuple[str, ...]) -> None:
        self._count += 1
        key = WarmKey(self._count, model)
        self.pending[key] = (decides, models)
        self._core.tasks.add(Task(key, (-1, self._count, 0, 0)))

    def on_warmed(self, task: Task, key: WarmKey, result: WarmResult) -> None:
        """Flip to the warmed model, or stay with the old one."""
        self._core.done(task, "warmed" if result.ready else "not ready", result.message)
        self._settle(key, result.ready, result.message)

    def on_failure(self, task: Task, key: WarmKey, message: str) -> None:
        """The probe failed or was lost: roll back."""
        self._core.done(task, "failed", message)
        self._settle(key, False, message)

    def _settle(self, key: WarmKey, ready: bool, message: str) -> None:
        model = key.model
        decides, models = self.pending.pop(key)
        previous = self.model if decides else ",".join(self.shadow)[:LABEL_CHARS_MAX]
        if decides and ready:
            self.model = model
        elif not decides and ready:
            joined = (*self.shadow, model)
            self.shadow = tuple(name for name in models if name in joined)
        note = message if decides else f"{WATCHES_ONLY}{message}"
        self._core.tell(ScorerChanged(model=model, previous=previous, ready=ready, message=note))

    def _drop(self, key: WarmKey, message: str) -> None:
        task = self._core.tasks.get(key)
        assert task is not None, f"{key} is pending but not to be done"
        self.on_failure(task, key, message)
