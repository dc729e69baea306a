"""Blender's shader trees as feeds: for each number and colour of a surface, a factor, a picture, vertex colours.

What is no product of those is `Unread`, and can be baked.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multilight.scenes.assets.formats.coordinates import IDENTITY, MESH, Affine, Place, Wrap, affine_of, matrix
from multilight.scenes.errors import MultilightError

Triple = tuple[float, float, float]
ONE: Triple = (1.0, 1.0, 1.0)
_WRAPS: dict[str, Wrap] = {"REPEAT": "repeat", "EXTEND": "clamp", "CLIP": "clamp", "MIRROR": "mirror"}


class UnreadError(MultilightError, ValueError):
    """A node that no feed can stand for."""


@dataclass(frozen=True)
class Feed:
    """What feeds an input: `factor` times a channel of a picture times vertex colours, where they are given.

    `image` lies at `place` (of the layer "": of the active one); `channel` is RGB, R, G, B or A. Of values below
    `cutoff` nothing is left, of others one.
    """

    factor: Triple = ONE
    image: Any = None
    channel: str = "RGB"
    place: Place = MESH
    colors: str | None = None
    cutoff: float = 0.0

    @property
    def value(self) -> float:
        """The factor as one number."""
        return sum(self.factor) / 3 if self.channel == "RGB" else self.factor[0]

    @property
    def plain(self) -> bool:
        """Whether it is the same everywhere."""
        return self.image is None and self.colors is None


Groups = tuple[Any, ...]
"""The group nodes that one is in, outermost first."""


def origin(socket: Any, groups: Groups) -> tuple[Any, Any, Groups] | None:
    """Return the node and output that feed an input, through reroutes and groups; None where nothing does."""
    while socket is not None and socket.is_linked:
        link = socket.links[0]
        node, output = link.from_node, link.from_socket
        if node.type == "REROUTE":
            socket = node.inputs[0]
        elif node.type == "GROUP" and node.node_tree is not None:
            ends = [n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output]
            socket = ends[0].inputs.get(output.name) if ends else None
            groups = (*groups, node)
            if socket is not None and not socket.is_linked:
                return None
        elif node.type == "GROUP_INPUT" and groups:
            socket = groups[-1].inputs.get(output.name)
            groups = groups[:-1]
        else:
            return node, output, groups
    return None


def feed_of(socket: Any, groups: Groups = ()) -> Feed:
    """Return what feeds an input; raises `UnreadError` naming the node in the way."""
    found = origin(socket, groups)
    if found is None:
        return Feed(triple(_unlinked(socket, groups)))
    node, output, groups = found
    match node.type:
        case "RGB" | "VALUE":
            return Feed(triple(output.default_value))
        case "TEX_IMAGE" if node.image is not None and node.image.source in ("FILE", "GENERATED"):
            layer, affine = _place(node.inputs["Vector"], groups)
            channel = "A" if output.name == "Alpha" else "RGB"
            return Feed(image=node.image, channel=channel, place=Place(layer, affine, _WRAPS[node.extension]))
        case "VERTEX_COLOR" if output.name == "Color":
            return Feed(colors=node.layer_name)
        case "ATTRIBUTE" if output.name == "Color" and node.attribute_type == "GEOMETRY":
            return Feed(colors=node.attribute_name)
        case "SEPARATE_COLOR" | "SEPRGB" if getattr(node, "mode", "RGB") == "RGB":
            return _channel(feed_of(node.inputs[0], groups), output.name[0])
        case "MATH":
            return _maths(node, groups)
        case "MIX" if node.data_type == "RGBA" and node.blend_type == "MULTIPLY":
            colours = [s for s in node.inputs if s.enabled and s.name in ("A", "B")]
            return _mixed(node.inputs[0], colours, groups)
        case "MIX_RGB" if node.blend_type == "MULTIPLY":
            return _mixed(node.inputs["Fac"], list(node.inputs)[1:], groups)
    raise UnreadError(f"a node {node.bl_label}")


def _unlinked(socket: Any, groups: Groups) -> Any:
    """Return the value of an input that nothing feeds: of a group's, that of the group."""
    if socket.is_linked:
        node, name = socket.links[0].from_node, socket.links[0].from_socket.name
        if node.type == "GROUP_INPUT" and groups:
            return _unlinked(groups[-1].inputs[name], groups[:-1])
        if node.type == "GROUP":
            ends = [n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output]
            return _unlinked(ends[0].inputs[name], (*groups, node))
        if node.type == "REROUTE":
            return _unlinked(node.inputs[0], groups)
    return socket.default_value


def triple(value: Any) -> Triple:
    """Return a colour, or a number three times."""
    numbers = [float(v) for v in value] if hasattr(value, "__len__") else [float(value)] * 3
    return numbers[0], numbers[1], numbers[2]


def _channel(feed: Feed, channel: str) -> Feed:
    if feed.channel != "RGB" or feed.colors is not None:
        raise UnreadError("a channel of what is no picture")
    return replace(feed, channel=channel, factor=(feed.factor["RGB".index(channel)],) * 3)


def product(a: Feed, b: Feed) -> Feed:
    """Multiply two feeds; at most one of them has a picture, at most one vertex colours."""
    if a.cutoff or b.cutoff or (a.image is not None and b.image is not None) or (a.colors and b.colors):
        raise UnreadError("a product of pictures")
    with_image = a if a.image is not None else b
    factor = triple([x * y for x, y in zip(a.factor, b.factor, strict=True)])
    return replace(with_image, factor=factor, colors=a.colors or b.colors)


def _mixed(share: Any, colours: list[Any], groups: Groups) -> Feed:
    amount, (a, b) = feed_of(share, groups), (feed_of(c, groups) for c in colours)
    if not amount.plain or (amount.value < 1 and not b.plain):
        raise UnreadError("a mix by a picture")
    if amount.value < 1:
        b = Feed(tuple(1 + amount.value * (v - 1) for v in b.factor))  # type: ignore[arg-type]
    return product(a, b)


def _maths(node: Any, groups: Groups) -> Feed:
    a, b = (feed_of(socket, groups) for socket in list(node.inputs)[:2])
    if node.operation == "MULTIPLY":
        return product(a, b)
    if node.operation == "LESS_THAN" and b.plain and not a.cutoff:
        return replace(a, cutoff=-max(b.value, 1e-6))  # the other way round, for the difference to one
    if node.operation == "GREATER_THAN" and b.plain and not a.cutoff:
        return replace(a, cutoff=max(b.value, 1e-6))
    if node.operation == "SUBTRACT" and a.plain and a.value == 1 and b.cutoff < 0:
        return replace(b, cutoff=-b.cutoff)
    if a.plain and b.plain and node.operation in ("ADD", "SUBTRACT", "DIVIDE"):
        sign = {"ADD": a.value + b.value, "SUBTRACT": a.value - b.value}
        return Feed((sign.get(node.operation, a.value / (b.value or 1.0)),) * 3)
    raise UnreadError(f"a node {node.bl_label} ({node.operation.lower()})")


def _place(socket: Any, groups: Groups) -> tuple[str, Affine]:
    """Return the UV layer that a picture is looked up with, and its transform."""
    found = origin(socket, groups)
    if found is None:
        return "", IDENTITY
    node, output, groups = found
    if node.type == "UVMAP":
        return node.uv_map, IDENTITY
    if node.type == "TEX_COORD" and output.name == "UV":
        return "", IDENTITY
    if node.type != "MAPPING" or node.vector_type not in ("POINT", "TEXTURE"):
        raise UnreadError(f"a node {node.bl_label} as texture coordinates")
    values = [feed_of(node.inputs[name], groups) for name in ("Location", "Rotation", "Scale")]
    location, rotation, scale = (v.factor for v in values)
    if not all(v.plain for v in values) or abs(rotation[0]) + abs(rotation[1]) > 1e-6:
        raise UnreadError("a Mapping that is fed, or turned out of the plane")
    layer, before = _place(node.inputs["Vector"], groups)
    cosine, sine = math.cos(rotation[2]), math.sin(rotation[2])
    own = np.array([[cosine * scale[0], -sine * scale[1], location[0]],
                    [sine * scale[0], cosine * scale[1], location[1]], [0, 0, 1]])  # fmt: skip
    if node.vector_type == "TEXTURE":
        if 0 in scale[:2]:
            raise UnreadError("a Mapping of scale 0")
        own = np.linalg.inv(own)
    return layer, affine_of(own @ matrix(before))
