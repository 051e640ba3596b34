"""The numbers that decide on a map: value, unit, reason, and class.

The unit is in the name or after the class, or the number has none. The classes:

* definition: what is called wrong, or the same.
* geometry: it follows from the geometry of views.
* level: a statistical level; the comment says how often chance exceeds it.
* measured: on data that the comment names.
* assumption: no data determine it; the comment says why this value.
* budget: it bounds time or memory.

``python docs/make/numbers_page.py`` lists all of them from the comments, with those that stay in other modules: gates
on depths, priors of a lens, the smooth errors of a view, what recognizes an overlay, and ``quest``. Numbers that change
the time of a fit but not its result stay beside the fit, and have no class.
"""

from __future__ import annotations

# -- what is wrong, and the terms of the risk ------------------------------------------------------------

#: A rotation and a direction are wrong from here on.
#: Class: definition.
WRONG_ROTATION_DEG, WRONG_DIRECTION_DEG = 5.0, 15.0

#: A baseline that is shorter than this share of the longest one has an uncertain direction although the position of its
#: camera is certain. Its direction is not evaluated.
#: Class: assumption.
SHORTEST_BASELINE = 0.3

#: Laplace is optimistic with few views. Factor on the standard deviation of the direction: 1.7 with two views, 1.2 with
#: twelve.
#: Class: assumption.
FEW_VIEWS = 0.7

#: Before a camera that only rotates, a moving object looks like a near object before points at infinity. So the rest of
#: the tracks has to show a translation without the tracks that gain most: moving objects that hold this share of them.
#: Class: assumption.
ON_OBJECTS = 0.5

#: A rotation or a competing motion with a larger probability is undecided, however precisely it is known. A direction
#: that is wrong with a larger probability is unknown, however far behind the competing motions are. A gain over the
#: rotation-only camera that chance exceeds more often is no evidence of a translation. But motions of a pair are tried
#: whose parallax chance exceeds less often: quest speaks of a translation from 1e-4 on, and further views may turn a
#: twentieth into a certainty.
#: Class: level.
UNDECIDED = 0.05

#: More likely than not: that a camera merely rotates, that bundle adjustment has left the motion of a map, or that a
#: window is wrong and worth no frame after it.
#: Class: level.
EVEN_ODDS = 0.5

#: Mean gain of a track, in chi-square, where there is no translation: its direction is chosen to suit the tracks, and
#: outliers gain more than noise (32 simulated windows).
#: Class: measured.
CHANCE_GAIN = 0.9

#: A quarter of the tracks is more than a moving object or two hold before a camera that rotates and zooms.
#: Class: assumption.
SHARE_OF_OBJECTS = 0.25

#: One scene in twenty has a moving object that fills the region with the largest vote.
#: Class: assumption.
OBJECTS_MOVE = 0.05

#: Two fits nearer than this are one: an order below what makes a map wrong.
#: Class: definition.
SAME_ROTATION_DEG, SAME_DIRECTION_DEG = 0.3, 2.0

#: Motions nearer than this lead to the same optimum: a third of what makes a map wrong.
#: Class: definition.
NEAR_ROTATION_DEG, NEAR_DIRECTION_DEG = 1.5, 5.0

#: Share of wrong maps that no term explains: two of 1490 maps were wrong (333 worlds of a generator that nobody had
#: seen and 270 of another one, 400 of two known failures, 487 starts on video), where the other terms expected 0.3.
#: Class: measured.
FLOOR = 1e-3

# -- looking at every frame ------------------------------------------------------------------------------

#: The information about a motion grows with the square of the baseline, which grows tenfold from the first window that
#: is evaluated to the last one.
#: Class: geometry.
INFORMATION_GROWS = 100.0

# -- the camera that only rotates, and the votes ---------------------------------------------------------

#: Nearly all focal lengths are known to two per cent, but some are guessed, and off by a fifth. For the camera that
#: only rotates the stated focal length is right, or wrong with this standard deviation of its logarithm at a price of
#: three nats (odds of one to twenty). So a fifth costs 5.5 nats, where the prior of right ones would charge 40, and a
#: translation would be the cheaper explanation. Half as long again costs 11: level flight looks like such a rotation.
#: Class: assumption, as a logarithm and in twice the nats.
WRONG_FOCAL, WRONG_FOCAL_COST = 0.1, 6.0

#: Largest vote of a track, as a difference of costs (twice the nats): so much it costs to say that it is an outlier.
#: Class: level, in twice the nats.
LARGEST_VOTE = 6.0

# -- nuisances -------------------------------------------------------------------------------------------

#: Standard deviation of the principal point of a calibration, over the width of the image: two pixels of 640, as a
#: chessboard measures it. Optical axes that nobody calibrated are off by a hundredth; with that, level flight with a
#: turn had no map in 12 worlds, since a turn about the optical axis moves the image by the error of the principal
#: point.
#: Class: assumption, over the width.
PRINCIPAL_SIGMA = 0.003

#: Standard deviation of an unknown readout about none: global shutters have none, and rolling ones take up to the time
#: between two frames of a video, which is two standard deviations.
#: Class: assumption.
READOUT_SIGMA_S = 1 / 60

#: Factor on the standard deviation of a readout: the turning of the frames has errors too, most of all that of the
#: newest one, and they do not average out over the tracks. It was chosen on seeds below 100. With it, two standard
#: deviations hold the truth in 96 % of 72 simulated windows of a hand-held camera (seeds from 260 000).
#: Class: measured.
TURNING_FACTOR = 2.5

#: Errors that a tracker keeps from view to view: they grow with the displacement of the image, up to a limit in pixels.
#: On rendered images of cameras that only turn, by up to 40 degrees with a wrong focal length or unstated distortion,
#: the best translation gains as much as with errors of up to 0.0033 of the displacement, and of 0.27 px at the most.
#: Class: measured, of the displacement and in px.
LASTING_SHARE, LASTING_PX = 0.004, 0.3

#: Errors that the tracks of a view share below the noise, in pixels, and that hence do not average out: the bias of
#: subpixel positions. On the same images it needs 0.014 px to explain what a plane gains that moves by 3 to 7 px.
#: Class: measured.
SHARED_PX = 0.02

#: How a lens may change from view to view: standard deviations of the zooms of the views, and of their shifts over
#: the width (each with a zoom of a third of it), with the probability that a window has them. Lenses that focus zoom by
#: up to three hundredths. Stabilizers shift a frame by up to a hundredth of the width, and change its scale by
#: thousandths. Large changes are rarer within a second than small ones, about in proportion to one over their size.
#: Half of the probability of a zoom is for a smooth one, the other half for independent ones.
#: Class: assumption, each with its probability.
ZOOMS = ((0.003, 0.02), (0.01, 0.006), (0.03, 0.002))
SHIFTS = ((0.001, 0.05), (0.003, 0.02), (0.01, 0.005))

#: Probability that the lens of a camera that only rotates zooms or that its images are shifted. The standard deviations
#: are the largest ones.
#: Class: assumption.
LENS_ZOOMS = 0.1
LARGEST_ZOOM = ZOOMS[-1][0]

#: Most that zooms cost, twice the negative log of their probability (2 log 100): in one shot of a hundred a person
#: zooms, by any factor. Without a bound, a zoom by a quarter would count as 8 standard deviations in each view.
#: Class: assumption, in twice the nats.
ZOOMED_COST = 9.2

#: Standard deviation of what zooms leave of their displacements, over these: the distortion changes with the focus. A
#: zoom lens by a factor of three moves the corners by half of the image, and its distortion changes by some hundredths
#: of it. Other errors are as large: of the centre, and of rows that are zoomed one after another. So large a share of
#: what the zooms explain is left too: a bound where the displacements are short.
#: Class: assumption.
ZOOM_LEAVES = 0.1

#: A neighbourhood holds a tenth of the tracks, and so about as much of the view: moving objects and the errors of a
#: lens extend that far. A larger one has fewer independent parts, and says less.
#: Class: assumption.
NEIGHBOURHOOD = 0.1

# -- a motion of other tracks ----------------------------------------------------------------------------

#: Of two rigid motions of the tracks either may be that of the camera, and the other one that of a moving object. The
#: odds that a moving object holds a share s of these tracks, and not 1 - s, fall with this power of s / (1 - s): a
#: scene at rest that holds half as many tracks as a moving object of equal area has odds of 1 to 12. So much fits 362
#: worlds with a moving object on at least 20 tracks, of four authors (95 %: 2.8 to 4.4).
#: Class: measured, over the tracks of such worlds.
RARER_BY_TRACKS = 3.6

#: Fewer tracks than this show no motion of their own, and lie on no plane: half of them may be outliers, and
#: ten tracks contradict a motion (quest's least number of matches).
#: Class: level.
LEAST_TRACKS = 20

#: Parts of the image (columns, rows) that err independently: errors of the lens and of the shutter extend over a
#: quarter of the image, and a dozen sums determine a standard deviation to a fifth.
#: Class: geometry.
REGIONS = (4, 3)

# -- whether points lie on a plane -----------------------------------------------------------------------

#: Points lie on a plane if distances of their own lower the cost by as much as noise does: by chi-square with one
#: degree of freedom a track, so by one on average. Their sum may exceed that by this number of standard deviations.
#: Class: level.
PLANE_SIGMAS = 2.5

#: The same where the poses follow. A depth variation of unknown size explains an excess of z standard deviations better
#: than chance does by exp(z^2 / 2), and it has one unknown more, which costs a factor of about three: even odds.
#: Class: level.
VARIATION_SIGMAS = 1.5

#: Least share of the tracks that a plane holds.
#: Class: level.
LEAST_ON_PLANE = 0.5

# -- the map of an accepted motion -----------------------------------------------------------------------

#: Largest risk that a further keyframe adds, over the largest risk that is accepted (``acceptance.max_risk``).
#: Class: assumption.
RISK_OF_A_VIEW = 0.1

# -- what names the reason of a refusal, and accepts nothing ---------------------------------------------

#: A distortion is suspected only if it is off by so many of its standard deviations: errors that the tracks share
#: double them.
#: Class: assumption.
DOUBTFUL_SIGMAS = 5.0
