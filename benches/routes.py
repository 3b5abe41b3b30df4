"""How short routes are after so much time, by solvers.

    python benches/routes.py [--instances K] [--sizes 13-15] [--milliseconds 10 100 1000] [--no-optimum]

OR-Tools and PyVRP where these are installed (`pip install numpy ortools pyvrp`), on one core, on the first K measured
instances of each size. Prints a line of JSON for each: length, up to 15 customers over the optimum of at most four trips,
and milliseconds an instance. Of more customers there are as many trips as anybody likes, as of one vehicle that drives all.
`sortie eval RUN --env routing/13-15` and `sortie bench allocation BUNDLE` have an allocator's beside them.
"""

import argparse
import json
import math
import os
import sys
import time

import numpy as np

# What a vehicle holds, by the most customers that have such vehicles.
CAPACITIES = {15: 25, 31: 30, 50: 40, 100: 50}
# Solvers count in whole numbers; PyVRP's penalties are for smaller ones.
UNIT, PYVRP_UNIT = 1_000_000, 10_000
# OR-Tools may look for a first solution without end where vehicles are nearly full.
PATIENCE_MS = 3_000


class SplitMix:
    """Steele, Lea and Flood's generator (2014), as `routing` draws instances."""

    def __init__(self, seed):
        self.state = seed

    def next(self):
        whole = (1 << 64) - 1
        self.state = self.state + 0x9E3779B97F4A7C15 & whole
        mixed = (self.state ^ self.state >> 30) * 0xBF58476D1CE4E5B9 & whole
        mixed = (mixed ^ mixed >> 27) * 0x94D049BB133111EB & whole
        return mixed ^ mixed >> 31

    def unit(self):
        return (self.next() >> 11) / (1 << 53)

    def below(self, bound):
        return (self.next() >> 32) * bound >> 32


def fleet(customers):
    """The most trips, and what a vehicle holds."""
    capacity = next(capacity for most, capacity in CAPACITIES.items() if customers <= most)
    return (4 if customers <= 15 else customers), capacity


def packs(demands, free):
    """Whether loads with so much room hold all demands, of which the largest come first."""
    if not demands:
        return True
    for load, room in enumerate(free):
        if room >= demands[0] and room not in free[:load]:
            if packs(demands[1:], [*free[:load], room - demands[0], *free[load + 1 :]]):
                return True
    return False


def measured(customers, number):
    """Distances `[n + 1, n + 1]`, the depot first, and demands."""
    random = SplitMix(customers * 1_000_000 + number)
    vehicles, capacity = fleet(customers)
    while True:
        places = np.array([[random.unit(), random.unit()] for _ in range(customers + 1)])
        demands = [0] + [1 + random.below(9) for _ in range(customers)]
        if packs(sorted(demands, reverse=True), [capacity] * vehicles):
            return np.linalg.norm(places[:, None] - places, axis=-1), np.array(demands)


def optimum(distances, demands):
    """The shortest routes of at most as many trips as vehicles (Held and Karp 1962, then the best partition)."""
    n = len(demands) - 1
    if n > 15:
        return None
    vehicles, capacity = fleet(n)
    masks = np.arange(1 << n)
    has = masks[:, None] >> np.arange(n) & 1
    count, load = has.sum(1), has @ demands[1:]
    ends = np.full((1 << n, n), np.inf)
    for last in range(n):
        ends[1 << last, last] = distances[0, last + 1]
    for size in range(2, n + 1):
        for last in range(n):
            sets = masks[(count == size) & (has[:, last] == 1)]
            ends[sets, last] = (ends[sets ^ 1 << last] + distances[1:, last + 1]).min(1)
    tours = (ends + distances[0, 1:]).min(1)
    tours[load > capacity] = np.inf
    tours[0] = 0.0
    best = tours
    trips = masks[(load <= capacity) & (count > 0)]
    for _ in range(vehicles - 1):
        longer = best.copy()
        for trip in trips:
            # Those that have nothing to do with this trip's customers, and its lowest one below all of theirs.
            rest = masks[(masks & trip == 0) & (masks & (trip & -trip) - 1 == 0)]
            longer[rest | trip] = np.minimum(longer[rest | trip], best[rest] + tours[trip])
        best = longer
    return best[-1]


def length(distances, routes):
    """The way of routes, lists of customers from 1."""
    stops = [[0, *route, 0] for route in routes]
    return sum(distances[one, other] for stop in stops for one, other in zip(stop, stop[1:]))


def by_ortools(distances, demands, milliseconds):
    """OR-Tools' routing: its first solution, and guided local search for so long after it."""
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    vehicles, capacity = fleet(len(demands) - 1)
    manager = pywrapcp.RoutingIndexManager(len(demands), vehicles, 0)
    routing = pywrapcp.RoutingModel(manager)
    # As tables: functions of Python's would be most of the time.
    way = routing.RegisterTransitMatrix(np.rint(distances * UNIT).astype(int).tolist())
    routing.SetArcCostEvaluatorOfAllVehicles(way)
    asks = routing.RegisterUnaryTransitVector(demands.tolist())
    routing.AddDimensionWithVehicleCapacity(asks, 0, [capacity] * vehicles, True, "load")
    search = pywrapcp.DefaultRoutingSearchParameters()
    search.first_solution_strategy = routing_enums_pb2.FirstSolutionStrategy.PATH_CHEAPEST_ARC
    if milliseconds:
        search.local_search_metaheuristic = routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    search.time_limit.FromMilliseconds(milliseconds or PATIENCE_MS)
    found = routing.SolveWithParameters(search)
    if found is None:
        return None
    routes = []
    for vehicle in range(vehicles):
        index, route = found.Value(routing.NextVar(routing.Start(vehicle))), []
        while not routing.IsEnd(index):
            route.append(manager.IndexToNode(index))
            index = found.Value(routing.NextVar(index))
        routes.append(route)
    return length(distances, routes)


def by_pyvrp(distances, demands, milliseconds):
    """PyVRP's search for so long."""
    import pyvrp

    vehicles, capacity = fleet(len(demands) - 1)
    whole, places = np.rint(distances * PYVRP_UNIT).astype(int), range(len(demands))
    data = pyvrp.ProblemData(
        [pyvrp.Location(0, 0) for _ in places],
        [pyvrp.Client(place, [int(demands[place])]) for place in places[1:]],
        [pyvrp.Depot(0)],
        [pyvrp.VehicleType(vehicles, [capacity])],
        [whole],
        [np.zeros_like(whole)],
    )
    found = pyvrp.solve(data, pyvrp.stop.MaxRuntime(milliseconds / 1000), display=False)
    if not found.is_feasible():
        return None
    customers = lambda route: [stop.idx + 1 for stop in route if stop.type == pyvrp.ActivityType.CLIENT]
    return length(distances, [customers(route) for route in found.best.routes()])


def solvers(milliseconds):
    """What is installed, as names and what they do."""
    known = []
    try:
        import ortools

        known.append((f"ortools {ortools.__version__}", lambda *it: by_ortools(*it, 0)))
        for limit in milliseconds:
            known.append((f"ortools, guided {limit} ms", lambda *it, limit=limit: by_ortools(*it, limit)))
    except ImportError:
        print("OR-Tools is not installed", file=sys.stderr)
    try:
        import pyvrp

        for limit in milliseconds:
            known.append((f"pyvrp {limit} ms", lambda *it, limit=limit: by_pyvrp(*it, limit)))
    except ImportError:
        print("PyVRP is not installed", file=sys.stderr)
    return known


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instances", type=int, default=100)
    parser.add_argument("--sizes", default="13-15")
    parser.add_argument("--milliseconds", type=int, nargs="*", default=[10, 100, 1000])
    parser.add_argument("--no-optimum", action="store_true", help="lengths alone: an optimum takes seconds")
    arguments = parser.parse_args()
    lowest, highest = (int(size) for size in arguments.sizes.split("-"))
    os.sched_setaffinity(0, [0])
    instances = [measured(n, i) for n in range(lowest, highest + 1) for i in range(arguments.instances)]
    optima = [None if arguments.no_optimum else optimum(*instance) for instance in instances]
    for name, solve in solvers(arguments.milliseconds):
        ratios, lengths, took = [], [], []
        for instance, best in zip(instances, optima):
            start = time.perf_counter()
            found = solve(*instance)
            took.append(1000 * (time.perf_counter() - start))
            if found is not None:
                lengths.append(found)
                ratios.append(found / (best or math.nan))
        spread = 1.96 * np.std(ratios) / math.sqrt(len(ratios))
        print(
            json.dumps(
                {
                    "solver": name,
                    "customers": arguments.sizes,
                    "length": round(float(np.mean(lengths)), 4),
                    # Of 16 customers and more it is not known.
                    "over_optimum": None if None in optima else round(float(np.mean(ratios)), 4),
                    "ci95": None if None in optima else round(float(spread), 4),
                    "milliseconds": round(float(np.median(took)), 2),
                    "p99": round(float(np.quantile(took, 0.99)), 2),
                    "unsolved": len(instances) - len(ratios),
                }
            ),
            flush=True,
        )


if __name__ == "__main__":
    main()
