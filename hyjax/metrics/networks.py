"""Networks of LPIPS, AlexNet and VGG-16, as lists of their convolutions.

Sources: AlexNet in the one-tower form of Krizhevsky, *One weird trick for parallelizing convolutional neural
networks*, 2014; VGG-16 of Simonyan and Zisserman, ICLR 2015.
"""

import dataclasses
from typing import Literal

Net = Literal["alex", "vgg"]


@dataclasses.dataclass(frozen=True)
class Convolution:
    """Convolution with bias and ReLU.

    Attributes:
        width: of its square kernel, in pixels.
        stride: in pixels.
        padding: zeros at each border.
        pool: width of the max pooling, with stride 2, of its input; 1 for none.
        compared: whether LPIPS compares its result.
    """

    width: int
    inputs: int
    outputs: int
    stride: int = 1
    padding: int = 1
    pool: int = 1
    compared: bool = True


@dataclasses.dataclass(frozen=True)
class Network:
    """Network as its convolutions, in order.

    Attributes:
        name: in files of weights.
        smallest: least height and width of a picture that leaves something to every layer.
        layers: its convolutions.
    """

    name: str
    smallest: int
    layers: tuple[Convolution, ...]

    @property
    def compared(self) -> tuple[int, ...]:
        """Numbers of channels of the compared layers."""
        return tuple(layer.outputs for layer in self.layers if layer.compared)


def _block(inputs: int, outputs: int, count: int, pool: int = 2) -> tuple[Convolution, ...]:
    """Stage of VGG, with its last layer compared."""
    return tuple(
        Convolution(
            3,
            inputs if k == 0 else outputs,
            outputs,
            pool=pool if k == 0 else 1,
            compared=k == count - 1,
        )
        for k in range(count)
    )


NETWORKS: dict[Net, Network] = {
    "alex": Network(
        "AlexNet_0",
        31,
        (
            Convolution(11, 3, 64, stride=4, padding=2),
            Convolution(5, 64, 192, padding=2, pool=3),
            Convolution(3, 192, 384, pool=3),
            Convolution(3, 384, 256),
            Convolution(3, 256, 256),
        ),
    ),
    "vgg": Network(
        "VGG16_0",
        16,
        (
            *_block(3, 64, 2, pool=1),
            *_block(64, 128, 2),
            *_block(128, 256, 3),
            *_block(256, 512, 3),
            *_block(512, 512, 3),
        ),
    ),
}
