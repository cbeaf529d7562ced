"""The model card of an encoder of pictures, in Markdown."""

from planspace.embed.pixels.encoder import ImageEncoder

TITLES = {
    "z_correlation": "correlation of z from pictures with z from states",
    "z_error": "error of z, in standard deviations of z",
    "straightness": "straightness (1 is straight)",
    "midpoint_error": "midpoint error (0 is straight)",
    "time_correlation": "correlation with time left",
    "decoded_error": "error of the estimated state, in standard deviations",
}
TARGETS = {
    "z": "z of the state, as the teacher computes it",
    "state": "the state, from which the teacher computes z",
    "random": "z of the state; only the last layer was trained, the others have random weights",
}
PRIVILEGED = """The network was trained on {}. **Privileged state in
training**: the states of the training pictures were known. The teacher is in the folder `teacher`."""
ALONE = """The network was trained on pictures of plans alone, with the objective `{}`. No state was
used. The folder `teacher` has an embedding of states that was fitted to z afterwards; the states of the
training pictures were known for that."""


def image_card(encoder: ImageEncoder) -> str:
    """Describe an encoder of pictures.

    Args:
        encoder: with its `about`.
    """
    view, metrics = encoder.pictures, encoder.about["metrics"]
    rows = "\n".join(f"| {TITLES[name]} | {value:.3f} |" for name, value in metrics.items())
    looks = f"camera {view.camera!r}" if view.camera else "first camera"
    return f"""# Encoder of pictures of {encoder.about["problem"] or "a robot"}

It computes z of {encoder.z_dim} numbers from stacks of {view.frames} pictures of
{view.height} x {view.width} pixels ({looks}), {encoder.frame_s:g} s apart, the oldest first: uint8, shape
{view.stack_shape}.

    from planspace import load_image_encoder
    encoder = load_image_encoder("DIR")
    z = encoder.encode(images)

## Training

{_training(encoder)}

## Held-out plans

| | |
|---|---|
{rows}

## Limits

It knows one robot, one camera and its colours. `encoder.distance(images)` says how far pictures are from
those of the training: 1 is the most unusual one. It has seen states near the demonstrations only.
"""


def _training(encoder: ImageEncoder) -> str:
    if encoder.target == "pictures":
        return ALONE.format(encoder.about["settings"]["fit"]["space"]["objective"].get("name", "function"))
    return PRIVILEGED.format(TARGETS[encoder.target])
