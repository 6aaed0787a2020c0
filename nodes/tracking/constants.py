"""The tracker's constants, all of them: unit, reason, and what sets each.

Tuned ones come first: generator A's figures are what sets them, unless it says otherwise. What each does to the figures
is measured by ``benchmarks/sensitivities.py``; which mechanisms were switched off, and what noticed, stands in
docs/decisions/0053. Those of effort make the tracker slower or quicker and are as large as a frame's time allows;
numerics are as fine, or as small, as to change no figure; facts are what they are."""

import numpy as np

# ---- Tuned ----

# Nodes' parameters: standard deviations of first poses, of what a push does in a frame, of a moving camera's course.
START_M, START_RAD = 0.005, 0.035
MOTION_M, MOTION_RAD = 0.010, 0.06
CAMERA_M, CAMERA_RAD = 0.0015, 0.0025
# Scores, 0 to 1: a match below the first is looked for farther away; an image below the second does not support a pose,
# nor keeps one from being found elsewhere than a push reaches; above the third what is lost may be found.
SURE_SCORE, KEPT_SCORE, FOUND_SCORE = 0.75, 0.35, 0.7
PATIENCE = 10  # images that speak against an object, until it is lost
VELOCITY_GAIN = 0.4  # how far a velocity follows the last observed one
PHYSICS_SIGMAS = 3.0  # standard deviations of a pose by which physics may move it from where it goes by itself
BODY_FRICTION = 0.5  # Coulomb's coefficient of tracked bodies

# Control points. Of an object of which fewer should be seen an image says nothing: of ten the share that is found errs
# by 0.15, a standard deviation of the binomial, about as far as scores that decide are apart.
LEAST_SHOWN = 10.0
LEAST_FOUND = 18.0  # control points: where fewer should be seen, an object is not found
# Cosine. Lines at less than 26° may be taken for one another: there a peak moves along a line by less than half of what
# it moves across.
PARALLEL = 0.9
# Share of a score. To what an image supports by less than this part of what the one before did, something happens: of
# 590 such pairs of objects at rest (generator A, hidden, low contrast, pushed before the push) none is less than 0.88.
LESS = 0.85

# How the image is read. Pixels along the normal, one a stage: far, where objects are calm, in tries elsewhere.
REACH_PX, CALM_REACH_PX, FINE_REACH_PX, ROUGH_REACH_PX = (14, 6), (8,), (10, 5), (20,)
# Where Tukey's weight ends, pixels, in the first and the last iteration of each stage.
SCALE_PX, CALM_SCALE_PX = ((14.0, 4.0), (5.0, 1.0)), ((8.0, 1.0),)
FINE_SCALE_PX, ROUGH_SCALE_PX = ((10.0, 4.0), (4.0, 1.0)), ((20.0, 6.0),)
# Least and largest end of Tukey's weight in the steps that follow, and by how many medians of the residuals' sizes it
# is there. Halved: -2.6 points within 2 mm, twice -0.6.
LAST_PX, ROUGH_LAST_PX, SPREADS = (0.3, 1.0), (4.0, 4.0), 3.5
CONTRAST = 1.5  # grey levels per pixel: smallest slope that counts as an edge; half or twice: -0.6 points
# Pixels, standard deviation of a match, as if control points erred by this independently; they err together, along an
# edge and from image to image, so it is larger than one of them errs. Half or twice: -0.6 points, 80 and 111 µm.
NOISE_PX = 0.7
SUPPORT_PX, ROUGH_SUPPORT_PX = 1.5, 3.0  # how near a hypothesis must be in the end to support a control point
# A blurred peak's weight: the power of its edge's sharpness beside the quantile that counts as in focus.
BLUR_POWER, USUAL_SHARPNESS = 4.0, 0.7
BESIDE_PX = (2, 3, 4)  # where beside a peak the colour of a side is read: beyond the lens's blur
STRANGE = 4.5  # variances: a peak that looks stranger than this supports no control point
LEAST_RARITY = 0.4  # where more than the rest of the places are near an edge, to be near one proves little
# Of a smooth surface that turns away from the light, too, so much of the outline is seen beside its own shadow.
LIMB_SEEN = 0.8
# Pixels, standard deviation. How far an outline is found beside its model's as a whole, all along it and from image to
# image: light, blur, the shadow at its foot. What is off by more is trusted less. No shadow falls beside a crease.
WHOLE_PX, CREASE_PX = 0.2, 0.1
# Pixels. Parallel edges that far apart have peaks of their own: three standard deviations of the lens's blur and ours;
# so far beyond its last control points an edge goes on.
CROWD_PX, BEYOND_PX = 3.0, 4.0
# Edges that are as near as this, and in depth by this share of it, are one that is listed twice.
SAME_PX, SAME_DEPTH = 0.7, 0.005

# What is remembered of looks. Variance of a colour that never changed, grey levels²: noise, and the reading's softness.
LEAST_SPREAD = 64.0
MOST_STRANGE, FORGIVEN = 4.0, 2.0  # variances: most that a side may look strange, and what a change of light excuses
FIRST_WEIGHT, OFFSET_FRAMES = 2.0, 40.0  # images until a colour counts; over which offsets of edges are remembered
LOOKS_FRAMES, FADING = 12.0, 0.7  # images over which looks are remembered; what is left of that after one with motion
DOUBT = 2  # a part of an edge is trusted by the share of images that it was found in to this power
SURE_SEEN, FOUND_PX = 0.9, 1.0  # chance of what is surely seen; how near a part of an edge is found, pixels
LEARNED_SCORE = 0.6  # with a lower score an object tells nothing of its looks

# Motion, in shares of a push's: what is predicted to move by less than the first rests (a push is that far behind after
# 14 images); less than the second is lit as it was, and so much is left open for one at rest; the least; at first.
AT_REST, FREEDOM, LEAST_MOTION_SCALE, FIRST_MOTION_SCALE = 0.1, 0.3, 0.02, 0.2
# What is predicted to move less than this from one image to the next, and is as calm, tells where its edges are off: by
# its shadows. Of what moves, the prediction is, and an edge that comes into view would soon not be trusted.
STILL_M, STILL_RAD = 0.0005, 0.002
# Share of a push that what moves may change its motion by, for every metre and radian in a frame, and at most.
CHANGE_PER_M, CHANGE_PER_RAD, MOST_CHANGE = 50.0, 4.0, 0.5
JUMP_PX = 2.0  # a camera's error that moves an object's origin by more is large
SURPRISED = 1.5  # standard deviations by which the image surprises; twice: the same poses
CALMING = 0.85  # share of its motion that something keeps from image to image, and of how far images had it off
SETTLED_M = 0.004  # where no object moves, and all are known better than this, the image is searched near by
RESTING_MARGIN = 0.1  # by so large a share of its control points another explanation than rest is clearly better
# How much a camera's drift changes from image to image, in shares of how far reports err; and, as a share, how large
# what has an exact model is beside it: blur, light and worn edges make it seem smaller. Of that variance all objects
# have so much in common, and so much of what comes to it where models are imprecise: what is worn is smaller.
DRIFTS, SIZES, SIZES_TOGETHER, WORN_TOGETHER = 0.6, 0.007, 0.1, 0.6
# Of what its motion may change in a frame, what stands rises by so much, and tilts; what falls over rises.
UPWARDS, TILTING, FALLING = 0.1, 0.15, 0.3
RESTING_M, RESTING_RAD = 0.0005, 0.004  # how certain the height and the tilt of a body at rest are
RESTING_M_S, RESTING_RAD_S = 0.1, 0.3  # and how fast one moves that is not
FLAT_M, BASE_M = 0.004, 0.003  # what lies on a face has corners no higher above the lowest, and spread as far
MOVES_SIGMAS, STOPPED_SIGMAS = 4.0, 1.0  # a mean displacement that has a body at rest move, and one that moves rest
TURNING = 6.0  # rad/s for a m/s: faster than this, beside how it moves, a body about to turn over turns
ACCELERATION = np.array([20.0, 300.0])  # largest of a body that is believed: m/s², rad/s²
DAMPING = 0.1  # how fast a body without a table slows down, 1/s
# Standard deviation of how far one goes that is not seen, for every metre that it was on its way to go.
UNSURE = 0.2
SINKS = 0.6  # what sinks by this part of a free fall is not carried

# What is seen. Of an object's size: a point that is deeper by more than this under its own surface is hidden by it.
OWN_SHARE = 0.01
CHAIN_END_PX = 3.0  # from the ends of an edge: near a corner, another one may be the nearest
# Standard deviations of what is left when both poses are certain: pixels are whole, models are not exact; how far
# inside the outline the depth of what may hide is read.
OUTLINE_PX, OUTLINE_M, INSIDE_PX = 0.7, 0.001, 1.5

# The likelihood. Chance that an edge that nothing hides has a peak at all; standard deviation of a peak, pixels.
FOUND, PEAK_PX = 0.9, 0.6
LEAST_CLUTTER = 0.02  # peaks a pixel: so many there may be where a profile shows none
# Points of one face look alike: standard deviation of their colours in grey levels, the share of them that do, and what
# they say together, by this exponent; standard deviation of the colours of places anywhere, at least.
PAINT, PAINTED, PAINT_ALIKE, LEAST_VARIED = 10.0, 0.8, 0.05, 30.0
DYE_LEAST = 0.1  # of an object's most frequent colour, what is a smaller share was seen beside it
ALIKE = 0.15  # control points of one edge err alike: what they say together counts by this exponent

# Imprecise models: standard deviations of where edges may be beside a model's, m; control points that should be seen of
# one that is judged; the score of an exact one that is not judged again; nats by which one is rather imprecise, before.
TOLERANCES_M, LEAST_JUDGED, DOING_WELL, RATHER = (0.0, 0.0007, 0.002), 30.0, 0.85, 2.5

# Elsewhere. Shares of its control points: another explanation must be better by this; so much must speak for one beyond
# that, however unlikely it was; so much speaks against one within a push or a fall of the expected one.
BETTER, UNLIKELIEST, EVENT = 0.03, 0.25, 0.18
EVENT_SEEN, MUCH = 0.08, 0.12  # the last where a still camera sees less of it; a share that is clearly more
PUSH_SQUARED = 36.0  # variances: what the image supports is no farther than a push can have moved it
CHANCE = 0.5  # what a control point speaks for a pose by chance: what is not seen speaks against it
CLEARLY = 1.5  # control points by which a candidate must be better than any that differs from it
CLAIM_PX = 2.5  # so near to an edge of an object that is surely seen, an edge is claimed by it
APART_M, APART_RAD = 0.008, 0.14  # poses that are farther apart differ
CERTAIN_SCORE = 0.95  # what was found again, or startled, just now and scores less is looked for elsewhere
# Standard deviations. An object whose place is less certain has to be found, not kept; is tried on a grid.
VAGUE_M, VAGUE_RAD, GRID_M = 0.02, 0.3, 0.015
# How much farther an object may be that was looked for in vain, and a body that was found again just now (m², rad²).
ASTRAY, BODY_ASTRAY = np.diag([0.01**2] * 3 + [0.3**2] * 3), np.diag([0.02**2] * 3 + [0.5**2] * 3)
OTHERS_SHARE = 0.1  # of a body's covariance, so much is left around each of its other poses

# ---- Tuned: without first poses ----

# By so many nats a pose has to explain the image better than clutter does: of the tens of thousands that were tried (e
# to the 11th) it is then right with odds of 20 to 1 at least, of 3000 to 1 where fewer of its points are found.
LEAST_NATS, SURE_NATS = 14.0, 19.0
# And by so much better than any other choice, nats, in as many images in a row as confirm it (by less, but no less than
# this over their number, in more); of which so many have to be its edges' and its known colours'; so many control
# points in sight: on generator A (tower, hidden 0, low contrast 0) right ones have at least 7.5, 8.2, 52.
CLEAR_NATS, LEAST_EDGES, LEAST_IN_SIGHT = 6.0, 8.0, 40.0
SWEEPS_FIRST = 3  # so often all that were never seen have to be looked for before one that is missing is believed
CONFIRMED, PROBATION = 3, 20  # images that have to show one in one place, or hanging; after which it is not doubted
# How far a pose in which a body rests may be off (m², rad²), and of that upwards, and about level axes: by the camera's
# error; of the height that bodies reach, how far it may be off, and by how much it is tried lower in turns.
RESTING_OFF, OFF_UPWARDS, OFF_TILTING = np.diag([0.012**2] * 3 + [0.12**2] * 3), 0.25, 0.15
ROUGH_HEIGHT, LOWER = 0.3, 0.25
MAP_CONTRAST, MAP_SLOPES = 2.0, 2.0  # smallest slope of an edge: grey levels per pixel of a map, medians of the slopes
MAP_NEAR_PX, MAP_AROUND_PX = 1.1, 31  # standard deviation of where an edge is; clutter is counted in windows of that
MAP_SOFT_PX, FACE_BESIDE_PX = 3, 5.0  # width of what colours are averaged over; how far beside an edge they are read
# Grey levels: standard deviation of the colours of a face at least; nats that a control point says at most, and by
# chance; what faces of one body differ by counts so much; places on a face that tell what it looks like.
FACE_SAME, FACE_MOST, FACE_CHANCE, FACE_CREASE, LEAST_LOOKS = 4.0, 2.0, 0.5, 0.3, 3
SWEPT_APART_PX, SWEPT_APART_RAD = 14.0, 0.2  # poses nearer than that, from one to the next, are one
TWIN_M = 0.004  # poses whose outlines are no farther apart than that in the mean look alike
SHARED, CLAIMED = 0.2, 0.35  # of a body's box, more in another's cannot be; of its edges, more are of the same thing
LIES_M = 0.008  # what is that near to something lies on it
FLOATS, FALLS = 3.0, 30.0  # nats that it costs that nothing is found which carries a body, and nothing is left that may
FARTHEST = 2.0  # places are no farther away than so many times what the camera looks at
# Shares of a body's diameter: what is that near to a plane lies on it; so far inside its foot its centre has to be;
# poses that differ by less at every corner look alike. Corners no farther below the highest, m, are the upper face's.
FLAT, STEADY, SAME_POSE, LEVEL_M = 0.004, 0.02, 0.01, 0.005

# ---- Effort ----

# Gauss-Newton steps in a stage: usually, where objects are calm, in tries; and after the last stage.
ITERATIONS, CALM_ITERATIONS, TRY_ITERATIONS, LAST_ITERATIONS, ROUGH_LAST_ITERATIONS = 6, 7, 5, 4, 1
SPACING_PX, POINTS_MAX = 4.0, 300  # from control point to control point, and how many an object has
TRIES_KEPT, ROUGH_POINTS = 4, 40  # starts that are aligned finely, and control points with which all are roughly
SEARCHED_AT_ONCE = 3  # objects that are looked for in an image
FARTHER = (1.0, 0.0, 0.5, 1.5, 2.0)  # shares of its motion at which one is looked for
GRID = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 5), np.linspace(-1.5, 1.5, 5)), axis=-1).reshape(-1, 2)
# Gauss-Newton steps and control points of the first look at an object's starts; poses that are added up in one go.
FIRST_ITERATIONS, FEW_POINTS, MANY = 3, 30, 16
AROUND = np.random.default_rng(1).normal(size=(4, 12, 6))  # where tries begin, in turns, standard deviations
TIPPED_WAYS, TIPPED_RAD = np.linspace(0.0, 2.0 * np.pi, 9)[:-1], (0.12, 0.25)  # towards where something may tip over
FAILED_AT_ONCE, FAILED_EVERY = 5, 8  # what was not found in so many images is looked for in one of every so many
AT_ONCE, GUESSES = 8, 3  # poses that are imagined of a body for one image, and that are kept of it
NEARLY_DOWN = 0.5  # cosine: on faces no farther from down one is imagined to rest that is seen where it cannot
# The table's texture: points of an image; how weak a corner may be beside the strongest one; how far away it may be, in
# heights of the camera; the share of points below which another image is looked at from then on; by which share of its
# contrast a patch may look otherwise; pixels from a patch's middle to its end, and to that of what is looked for.
TEXTURE_POINTS, TEXTURE_CORNER, TEXTURE_FAR, TEXTURE_KEPT, TEXTURE_OTHER = 64, 0.01, 8.0, 0.5, 0.5
PATCH_PX, WINDOW_PX = 20, 12
# Standard deviations by which both images are smoothed, one after the other; steps with each at most, until one moves
# points by less than this.
TEXTURE_BLURS_PX, TEXTURE_STEPS, TEXTURE_SETTLED_PX = (2.5, 0.8), 4, 0.3
JUDGED_EVERY = 15  # images until a model that does not do so well is judged again

# ---- Effort: without first poses ----

FRESH, OLD, RIVALS = 6, 5, 8  # guesses of a sweep, and of those that were judged, that go up; objects chosen together
SWEPT_AT_ONCE, SWEPT_EVERY, SWEPT_TOGETHER = 6, 3, 2  # as of what failed, of sweeps; so many in an image
CHOICES = 50_000  # beginnings of choices of one pose for each object that are followed in one go
COVERED_AFTER = 90  # sweeps without success, before a missing body is looked for on another missing one, too
SEARCHED_WIDE_PX = 640  # images that are as many times as wide, or as many and a half, are searched as much smaller
STEP_PX, YAWS, TEMPLATE_POINTS, BUDGET = 11, 24, 40, 150_000  # from place to place; turns; control points; poses
MOST_FACES, HULL_CORNERS = 12, 40  # the lowest faces on which a body may rest; of its hull's corners
# Maps, and images that templates are drawn in, are smaller by this; these reach so far from their middle at least, in
# focal lengths.
SHRUNK, TEMPLATE_SHRUNK, TEMPLATE_HALF = 2, 2.0, 0.25
ELEVATION_RAD, DISTANCE = np.radians(7.5), 1.15  # steps between the views that templates are made for
EVERY, SECOND, CLOSER, GIVEN = 3, 8000, 600, 80  # control points that sweeps begin with; poses that go on from there
TRY_PX, TRY_RAD = 5.0, 0.09  # steps of the closer look

# ---- Numerics ----

LEAST_CHANCE = 0.02  # control points that are less likely to be seen are left out
SAMPLES = np.random.default_rng(0).normal(size=(512, 6))  # of which probabilities are shares
EDGE_EASE = 1e-5  # share of a patch's slopes that is counted along its edge, where there are none
# Chromaticities told apart, by red's share and by green's (gray is in the middle of one); every so many pixels of an
# image; how far one is blurred, steps; what share of an image may be anything.
DYES, DYE_STEP, DYE_SOFT, DYE_ANY = 25, 4, 1.0, 0.01
LEANING_RAD = np.pi / 8  # how far something is taken to have leant over that has fallen: any such angle tells both ways
FOOT = 0.25  # share of its height in which a body has its foot
COVER_PX = 8  # side of a cell that something covers, or nothing
ERROR_STEP, TEXTURE_ITERATIONS = 1e-5, 5  # m and rad, of derivatives; reweighted least squares
TWO_MEDIAN = 1.386  # of the squared length of what is normally distributed in two dimensions, of variance 1
EXACTLY = 1e14 * np.eye(6)  # information of a camera of which nothing is open
SAME_SIZE = 1e-6  # standard deviation of how large what is told to be exact is, as a share: none, but for the inverse
EASE = 1e-3  # share of the prior that is counted as seen, so that what no edge shows stays finite
MOST_ROWS = 30_000  # OpenCV takes less than 32768 rows at a time
IMAGE_MARGIN_PX, ALONG_M = 3.0, 0.001  # what profiles are read beyond; a dash by which an edge's direction is told
DRAWS, BASES = 512, (2, 3, 5, 7, 11, 13)  # evenly spread draws
SLANT = 0.1  # sine: what is seen at less of a slant from above than that is not moved along the line of sight
OUTSIDE_PX, REACH_OUTSIDE_PX = 8.0, 24  # how far outside an image points, outside an outline its errors are looked at
SECTORS, OWN_BESIDE_PX = 12, 1.0  # directions that smooth outlines are told apart by; where own depth is looked up
HIDDEN_SIGMAS = 3.0  # standard deviations in depth at which a point is before something for sure
PHASES = (0.7549, 0.5698)  # of a step, by which the places of one sweep are beside those of the one before
DIRECTIONS, SLOPE_PARTS, CHUNK = 8, 16, 2048  # of edges in maps; parts of a grey level; poses that are judged at once
# Of a box: its corners, and places in it.
BOX_CORNERS = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
BOX_SAMPLES = np.stack(np.meshgrid(*[np.linspace(-0.45, 0.45, 6)] * 3), axis=-1).reshape(-1, 3)
UNKNOWN = np.diag([0.1**2] * 3 + [0.6**2] * 3)  # a covariance that says next to nothing of a pose (m², rad²)
UNSEEN = np.diag([0.01**2] * 3 + [0.1**2] * 3)  # of a body's pose before the first observation (m², rad²)
DASH_M = 0.002  # of an edge as it is drawn
THINNEST_M = 0.0001  # how thick a model is taken to be at least: paper

# ---- Facts ----

# A lens adds up light, and cameras encode the sum, about by its square root (IEC 61966-2-1): there a blurred step from
# dark to bright is steepest too far in the dark, and bright objects seem larger, and nearer, all around.
GAMMA = 2.2
LIGHT = (255.0 * (np.arange(256) / 255.0) ** GAMMA).astype(np.float32)  # of each grey level
RIGHT_M, RIGHT_RAD = 0.005, float(np.radians(5.0))  # a pose within both of the truth is right
STRANGE_WEIGHT = 0.5  # nats for every variance by which colours beside a peak are off what is remembered: a Gaussian's
DENSITY_KG_M3 = 500.0  # wood's
DEFAULT_INTERVAL_S = 1.0 / 30.0  # from frame to frame, until two have come
