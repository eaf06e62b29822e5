/* compare-images A B...: prints the largest and the mean difference of images A and B, in steps
 * of 255; of several pairs, the worst. An image may be a frame of a video, FILE#NUMBER. Exit
 * status 1: the sizes differ, or an image cannot be read. */
#include <stdio.h>
#include <stdlib.h>

#include "io/image.h"

int main(int argc, char **argv)
{
    int largest = 0;
    double worst_mean = 0;

    for (int i = 1; i + 1 < argc; i += 2) {
        uint8_t *rgb[2];
        int width[2], height[2];
        double sum = 0;

        for (int k = 0; k < 2; k++)
            if (spin_image_read(argv[i + k], NULL, &width[k], &height[k], &rgb[k]) != SPIN_OK) {
                fprintf(stderr, "compare-images: %s\n", spin_last_error());
                return 1;
            }
        if (width[0] != width[1] || height[0] != height[1]) {
            fprintf(stderr, "compare-images: '%s' and '%s' are of different sizes\n", argv[i],
                    argv[i + 1]);
            return 1;
        }
        for (int j = 0; j < 3 * width[0] * height[0]; j++) {
            int d = abs(rgb[0][j] - rgb[1][j]);

            largest = d > largest ? d : largest;
            sum += d;
        }
        sum /= 3.0 * width[0] * height[0];
        worst_mean = sum > worst_mean ? sum : worst_mean;
        free(rgb[0]);
        free(rgb[1]);
    }
    printf("%d %.4f\n", largest, worst_mean);
    return 0;
}
