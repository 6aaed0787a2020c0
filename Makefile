# Everything goes into .venv; PYTHON is what makes it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
RUNS := $(VENV)/.runs
CHECKED := .build/checked
ROS := $(VENV)/ros/.installed
RIVALS := $(VENV)/rivals/.installed
WHEELS := 'ros-rclpy[fastrtps]>=9.1,<9.2' 'empy<4' $(foreach name,sensor geometry visualization diagnostic,ros-kilted-$(name)-msgs)

.PHONY: demo test test-long check docs sweep model sim sensitivities mutations kills cameras ros2 changes growth fuzz attacks line2d rival generator_b peers tutorial interrupts clean test-quick format junk

# what runs, recordings included, and what tests need besides: the viewer alone is some hundreds of megabytes
$(RUNS): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[record]"
	touch $@

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	touch $(RUNS) $@

# ROS 2 as wheels, 45 MB, with Fast DDS alone, and what tests need of its types besides. They are in a place of their own,
# which sees all of .venv: every Python that finds them begins a second time, for the sake of its LD_LIBRARY_PATH.
$(ROS): $(INSTALLED) tests/support/ros_types.py
	$(PYTHON) -m venv $(VENV)/ros
	echo "import site; site.addsitedir('$$($(BIN)/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")')" \
		> "$$($(VENV)/ros/bin/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")/beside.pth"
	{ $(VENV)/ros/bin/python -m pip install --quiet --disable-pip-version-check $(WHEELS) && \
		$(VENV)/ros/bin/python tests/support/ros_types.py && touch $@; } || \
		echo "ROS 2 could not be installed: tests that talk to it are skipped" >&2

# ezmsg and dora, likewise in a place of their own that sees all of .venv
$(RIVALS): $(INSTALLED)
	$(PYTHON) -m venv $(VENV)/rivals
	echo "import site; site.addsitedir('$$($(BIN)/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")')" \
		> "$$($(VENV)/rivals/bin/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")/beside.pth"
	$(VENV)/rivals/bin/python -m pip install --quiet --disable-pip-version-check \
		'ezmsg>=3.9,<4' 'dora-rs==1.1.*' 'dora-rs-cli==1.1.*' 'pyarrow>=20' && touch $@

# docs/speed.md: an epoch beside plain Zenoh, ezmsg, dora and ROS 2; some five minutes
peers: $(RIVALS) $(ROS)
	$(BIN)/hierax bench peers

demo: $(RUNS)
	$(BIN)/hierax launch deploy/tracking.yaml --epochs 60 --output demo-output --overwrite
	$(BIN)/python -m hierax.nodes.tracking.evaluation.report demo-output
	@echo "Look at demo-output/pictures/contact-sheet.png and demo-output/errors.png"

# three workers, for two cores; tests/conftest.py says which has what
test: $(INSTALLED) $(ROS)
	$(BIN)/python -m pytest --numprocesses 3 -m "not long"

test-long: $(INSTALLED) $(ROS)
	$(BIN)/python -m pytest --numprocesses 3 -m long

# those that start no process and take no while: for the loop of who works on it
test-quick: $(INSTALLED)
	$(BIN)/python -m pytest --numprocesses 2 --quiet -m "not slow and not processes and not long"

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# those tests that could go on for ever, with more examples than in the suite (tests/support/sweep.py)
sweep: $(INSTALLED)
	HIERAX_SWEEP=1 $(BIN)/python -m pytest --numprocesses 2 tests/model tests/schemas/test_hostile_bytes.py \
		tests/runtime/core tests/runtime/deployment tests/runtime/engine tests/runtime/sim tests/runtime/launch

# docs/model.md; Debian's spin is installed where it is missing, if root may
model: $(INSTALLED)
	@command -v spin > /dev/null || test "$$(id -u)" != 0 || ! command -v apt-get > /dev/null || \
		{ apt-get update -qq && apt-get install -y -qq spin > /dev/null; }
	@command -v spin > /dev/null && command -v gcc > /dev/null || { echo "the model needs spin and gcc" >&2; exit 1; }
	HIERAX_SWEEP=1 $(BIN)/python -m pytest tests/model

# docs/simulation.md: 20 000 seeds under simulated faults, some five minutes on two idle cores
sim: $(INSTALLED)
	$(BIN)/hierax sim --seeds 0:20000
	$(BIN)/hierax sim --seeds 0:20000 --rates

# docs/simulation.md: the first seed that notices each planted mistake; some ten minutes
mutations: $(INSTALLED)
	$(BIN)/python benchmarks/mutations.py

# docs/recovery.md: kills, stops and resumes launches of the tracking deployment, for some ten minutes
kills: $(INSTALLED)
	$(BIN)/python benchmarks/kills.py

# docs/placement.md: 500 random hierarchies in random processes with a kill each, and what an epoch costs by partition; an hour
.PHONY: partitions
partitions: $(INSTALLED)
	$(BIN)/python benchmarks/partitions.py
	$(BIN)/python benchmarks/placement.py

# docs/cameras.md: a video beside its folder, 60 kills before a stream; some minutes
cameras: $(INSTALLED)
	$(BIN)/python benchmarks/cameras.py

# docs/ros2.md: photographs by rclpy and as a bag, beside a node of rclpy that only answers; some minutes
ros2: $(ROS)
	$(BIN)/python benchmarks/ros2.py

# docs/tower.md: 20 scenes for each builder and interference, five of each launched, too, and three with kills; eight hours;
# but for the kills it goes on where it was ended
TOWERS := --jobs 2 --keep benchmarks/towers.jsonl
.PHONY: towers
towers: $(INSTALLED)
	status=0; for cell in "" "--person every --least 18" "--person random --least 17" \
		"--least 18 --set cubes=6 --set tower=[[3,1,4],[2,5,6]]"; do \
		$(BIN)/python benchmarks/tower.py $(TOWERS) --builder reactive,planner --launched 3:8 $$cell || status=1; done; \
		$(BIN)/python benchmarks/tower_changes.py || status=1; exit $$status

# docs/tower.md: what becomes of towers without looking, ended after 1300 frames, and without what comes down, in
# as many frames as those with all of it take at most; some three hours
.PHONY: towers-without
towers-without: $(INSTALLED)
	$(BIN)/python benchmarks/tower.py $(TOWERS) --least 0 --builder open_loop --person none,knock,random --set frames=1300
	for without in "" "--without builder" "--without skills" "--without others" "--without spatial"; do \
		$(BIN)/python benchmarks/tower_errors.py --scenes 0:20 --jobs 2 --keep benchmarks/towers_without.jsonl \
			--least 0 --set frames=1600 $$without || exit 1; done

# docs/changing.md: 200 changes each of three hierarchies that run; some ten minutes
changes: $(INSTALLED)
	$(BIN)/python benchmarks/changes.py

# docs/speed.md: 2.4 MB up and down through 100 000 epochs, a process killed every 2 s; some ten minutes
.PHONY: arrays
arrays: $(INSTALLED)
	$(BIN)/python benchmarks/arrays.py

# docs/speed.md: what a node costs in hierarchies of 9 to 10 000, and processes beside plain Zenoh; some ten minutes
growth: $(INSTALLED)
	$(BIN)/python benchmarks/growth.py
	$(BIN)/python benchmarks/growth_launch.py

# docs/limits.md: 10⁶ things said on all keys of a launch; some minutes
fuzz: $(INSTALLED)
	$(BIN)/python benchmarks/fuzz_keys.py

attacks: $(INSTALLED)
	$(BIN)/python benchmarks/attacks.py

# docs/recording.md: recordings with junk in every field, and all commands that read them; some twenty minutes
junk: $(INSTALLED)
	$(BIN)/python benchmarks/junk.py

# docs/tracking-constants.md: each constant of the tracker, halved and doubled; some hours, and goes on where it was stopped
sensitivities: $(INSTALLED)
	mkdir -p .build/sensitivities
	$(BIN)/python benchmarks/sensitivities.py .build/sensitivities --log .build/sensitivities/found.jsonl \
		--write docs/tracking-constants.md

# docs/tutorial.md word by word, from both of its beginnings, with a fresh clone and what pip fetches; some ten minutes
tutorial: $(INSTALLED)
	$(BIN)/python benchmarks/tutorial.py

# docs/limits.md: Ctrl-C at random instants of commands; some minutes
interrupts: $(INSTALLED)
	$(BIN)/python benchmarks/interrupts.py

# LINE-2D, for benchmarks/line2d_rival/compare.py: OpenCV with its contributed modules, in an environment of its own
line2d: $(INSTALLED)
	python3 -m venv .venv/line2d
	.venv/line2d/bin/python -m pip install --quiet --disable-pip-version-check "opencv-contrib-python-headless>=4.10" numpy

# ViSP's model-based tracker, for benchmarks/visp_rival/compare.py; installed where it is missing, if root may
rival: $(INSTALLED)
	@test -d /usr/include/$$(gcc -dumpmachine)/visp3/mbt || test "$$(id -u)" != 0 || ! command -v apt-get > /dev/null || \
		{ apt-get update -qq && apt-get install -y -qq --no-install-recommends libvisp-mbt-dev > /dev/null; }
	mkdir -p .build/visp_rival
	g++ -O2 -std=c++17 -I/usr/include/$$(gcc -dumpmachine) -I/usr/include/opencv4 benchmarks/visp_rival/tracker.cpp \
		-o .build/visp_rival/tracker -lvisp_mbt -lvisp_klt -lvisp_me -lvisp_vision -lvisp_io -lvisp_core

# docs/scenes.md: MuJoCo for benchmarks/generator_b, and what it draws with; installed where it is missing, if root may
generator_b: $(INSTALLED)
	@ldconfig -p | grep -q libEGL_mesa || test "$$(id -u)" != 0 || ! command -v apt-get > /dev/null || \
		{ apt-get update -qq && apt-get install -y -qq --no-install-recommends libegl1 libgl1 libgl1-mesa-dri > /dev/null; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[bench]"

# mypy and the import contracts follow the namespace through an installed copy
check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	rm -rf $(CHECKED) build
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(CHECKED) .
	rm -rf build
	cd $(CHECKED) && MYPYPATH=. $(CURDIR)/$(BIN)/mypy --config-file $(CURDIR)/pyproject.toml --cache-dir $(CURDIR)/.mypy_cache \
		--explicit-package-bases --namespace-packages -p hierax
	cd $(CHECKED) && PYTHONPATH=. $(CURDIR)/$(BIN)/lint-imports --config $(CURDIR)/.importlinter --no-cache

# the site, in .build/site; the reference is read from an installed copy, as the static checks are
docs: $(INSTALLED)
	rm -rf .build/reference build
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target .build/reference .
	rm -rf build
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

clean:
	rm -rf $(VENV) .build build dist *.egg-info demo-output
