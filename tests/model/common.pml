/* What the models share. */

/* The processes of the world, the arm and spatial. */
#define W 0
#define A 1
#define S 2

/* Spin 6.5 stumbles over its own conditional expression in some inlines. */
#define IF(c, a, b) ((c) * (a) + !(c) * (b))
