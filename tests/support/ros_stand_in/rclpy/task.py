"""Futures: results that will be known later."""


class Future:
    def __init__(self):
        self._done = False
        self._result = None

    def done(self):
        return self._done

    def result(self):
        return self._result

    def set_result(self, result):
        self._done = True
        self._result = result
