"""The same emergency brake for all scenarios of a batch at once, with NumPy."""

import numpy as np
from cornercase_client import BatchFunction, serve_batches


class Aeb(BatchFunction):
    """Brakes if the leader is closer than the ego comes in the time to brake."""

    columns = ["leader_gap", "leader_closing"]
    option_names = ["time_to_brake"]

    def start(self, batch):
        """Begin a batch; an option may differ between scenarios if it is a dimension of a search."""
        options = [batch.options_of(n).get("time_to_brake", 1.5) for n in range(batch.scenarios)]
        self.time_to_brake = np.array(options)

    def step(self, step):
        """Decide one step of all active scenarios."""
        gap, closing = (np.frombuffer(step.columns[name]) for name in self.columns)
        return {"acceleration": np.where(gap < self.time_to_brake[step.scenarios] * closing, -8.0, 0.0)}


serve_batches(Aeb())
