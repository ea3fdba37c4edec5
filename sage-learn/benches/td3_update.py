"""An update of TD3 in eager PyTorch at the published sizes, to set beside `cargo bench -p sage-learn --bench td3_update`.

Needs PyTorch. One thread: `python3 sage-learn/benches/td3_update.py`.
"""

import copy
import statistics
import time

import torch
from torch import nn

OBSERVATION, ACTION, HIDDEN, BATCH = 101, 2, 256, 256
DISCOUNT, TAU, DELAY, NOISE, CLIP, RATE = 0.99, 0.005, 2, 0.2, 0.5, 3e-4
WARM_UP, SAMPLES, UPDATES = 50, 20, 50


def network(inputs, outputs):
    return nn.Sequential(
        nn.Linear(inputs, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, outputs)
    )


class Learner:
    def __init__(self):
        self.actor = nn.Sequential(network(OBSERVATION, ACTION), nn.Tanh())
        self.critics = nn.ModuleList([network(OBSERVATION + ACTION, 1) for _ in range(2)])
        self.pairs = [(net, copy.deepcopy(net)) for net in (self.actor, self.critics)]
        self.actor_adam = torch.optim.Adam(self.actor.parameters(), lr=RATE)
        self.critics_adam = torch.optim.Adam(self.critics.parameters(), lr=RATE)
        self.updates = 0

    def update(self, observations, actions, rewards, next_observations, not_terminal):
        self.updates += 1
        (_, target_actor), (_, target_critics) = self.pairs
        with torch.no_grad():
            noise = (torch.randn_like(actions) * NOISE).clamp(-CLIP, CLIP)
            next_actions = (target_actor(next_observations) + noise).clamp(-1, 1)
            inputs = torch.cat([next_observations, next_actions], 1)
            q = torch.min(target_critics[0](inputs), target_critics[1](inputs))
            target = rewards + not_terminal * DISCOUNT * q
        inputs = torch.cat([observations, actions], 1)
        loss = sum(nn.functional.mse_loss(critic(inputs), target) for critic in self.critics)
        self.critics_adam.zero_grad()
        loss.backward()
        self.critics_adam.step()
        if self.updates % DELAY == 0:
            loss = -self.critics[0](torch.cat([observations, self.actor(observations)], 1)).mean()
            self.actor_adam.zero_grad()
            loss.backward()
            self.actor_adam.step()
            for online, target in self.pairs:
                for p, p_target in zip(online.parameters(), target.parameters()):
                    p_target.data.copy_(TAU * p.data + (1 - TAU) * p_target.data)


def main():
    torch.set_num_threads(1)
    torch.manual_seed(0)
    learner = Learner()
    batch = [
        torch.rand(BATCH, OBSERVATION),
        torch.rand(BATCH, ACTION),
        torch.randn(BATCH, 1),
        torch.rand(BATCH, OBSERVATION),
        torch.ones(BATCH, 1),
    ]
    for _ in range(WARM_UP):
        learner.update(*batch)
    samples = []
    for _ in range(SAMPLES):
        start = time.perf_counter()
        for _ in range(UPDATES):
            learner.update(*batch)
        samples.append(1e3 * (time.perf_counter() - start) / UPDATES)
    low, high = min(samples), max(samples)
    print(f"PyTorch {torch.__version__}, one thread: {statistics.median(samples):.2f} ms [{low:.2f}, {high:.2f}]")


if __name__ == "__main__":
    main()
