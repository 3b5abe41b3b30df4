/* Tests of the C interface: recorded answers, and an error for everything that is wrong.
 *
 *   c_interface REPOSITORY */
#include <stdio.h>

#include "support.h"

int main(int count, char **arguments)
{
    if (count != 2) {
        fprintf(stderr, "usage: %s REPOSITORY\n", arguments[0]);
        return 2;
    }
    repository = arguments[1];
    recorded();
    bad_plans();
    bad_calls();
    guards();
    puts("the C interface answers as recorded, and refuses what is wrong");
    return 0;
}
