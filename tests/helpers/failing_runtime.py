# SPDX-License-Identifier: GPL-3.0-or-later
"""onnxruntime with providers that this machine has not, and that fail when they are told to."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import onnxruntime

CUDA, CPU = "CUDAExecutionProvider", "CPUExecutionProvider"


class FailingSession:
    """A session that works on the processor until it has answered so many calls."""

    def __init__(self, runtime, model, options, providers):
        (self.provider,) = providers
        if runtime.calls.get(self.provider) is None:
            raise RuntimeError(f"no device for {self.provider}\nand a second line")
        self._runtime = runtime
        self._session = onnxruntime.InferenceSession(model, options, providers=[CPU])

    def get_providers(self):
        return [CPU] if self.provider in self._runtime.refused else [self.provider]

    def io_binding(self):
        return self._session.io_binding()

    def run_with_iobinding(self, binding):
        runtime = self._runtime
        if runtime.calls[self.provider] <= 0:
            raise RuntimeError(f"{self.provider} has died")
        runtime.calls[self.provider] -= 1
        runtime.answered += 1
        self._session.run_with_iobinding(binding)


class FailingRuntime(SimpleNamespace):
    """Stands in for the module onnxruntime.

    calls : dict, how many calls each provider answers before it dies; None: it cannot even be opened
    refused : providers that onnxruntime quietly replaces by the processor
    """

    def __init__(self, calls, version=onnxruntime.__version__, refused=()):
        super().__init__(__version__=version, SessionOptions=onnxruntime.SessionOptions)
        self.calls, self.refused, self.answered = dict(calls), refused, 0

    def get_available_providers(self):
        return list(self.calls)

    def InferenceSession(self, model, options, providers):
        return FailingSession(self, model, options, providers)

    def install(self, monkeypatch):
        """Be what is imported as onnxruntime."""
        monkeypatch.setitem(sys.modules, "onnxruntime", self)
        return self
